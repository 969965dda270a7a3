"""Problems of an installation, found in the facts of `system`, with advice."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from ..base.manual import address_of
from ..base.memory import in_units
from ..base.spelling import did_you_mean

LITTLE_MEMORY = 2 * 2**30
VARIABLES = "POINTRAY_CACHE", "POINTRAY_CHECK", "POINTRAY_KERNELS", "POINTRAY_THREADS"
TEXT_BROWSERS = {"www-browser", "links", "elinks", "lynx", "w3m"}
REMOTE = "Open the printed address in a browser. On a remote machine forward the port first: ssh -L 8080:127.0.0.1:8080"


def find_problems(facts: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the problems in the facts of `describe_system`, each with advice.

    Facts that could not be found are problems too.
    """
    found = [
        (f"{name.replace('_', ' ')}: {value}", f"Report it: {address_of('troubleshooting.html#report-a-bug')}")
        for name, value in facts.items()
        if isinstance(value, str) and value.startswith("unknown (") and "POINTRAY_" not in value
    ]
    for check in (_of_variables, _of_kernels, _of_packages, _of_machine, _of_cache, _of_browser):
        try:
            found += check(facts)
        except (AttributeError, KeyError, TypeError):  # a fact that it needs is unknown
            continue
    return found


def _of_variables(facts: dict[str, Any]) -> Iterator[tuple[str, str]]:
    values = facts["variables"]
    for name in values:
        if name.startswith("POINTRAY_") and name not in VARIABLES:
            yield f"{name} is not a variable of pointray{did_you_mean(name, VARIABLES)}", "Unset it, or rename it."
    if values.get("POINTRAY_CHECK", "0") not in ("", "0"):
        yield "POINTRAY_CHECK is set: kernels check every array access and are slow", "Unset it."
    kernels = values.get("POINTRAY_KERNELS") or "auto"
    if kernels == "jit":
        yield "POINTRAY_KERNELS=jit: the compiled kernels are not used", "Unset it."
    elif kernels not in ("auto", "compiled"):
        yield f"POINTRAY_KERNELS={kernels} is invalid", "Set it to auto, compiled or jit, or unset it."
    threads, cpus = values.get("POINTRAY_THREADS"), facts["cpus"]
    if threads and not re.fullmatch("0*[1-9][0-9]*", threads):
        yield f"POINTRAY_THREADS={threads} is invalid", "Set it to a number of threads, or unset it."
    elif threads and int(threads) != cpus:
        yield f"POINTRAY_THREADS={threads}, but there are {cpus} CPUs", "Unset it, to use those that are available."
    if values.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        yield "NUMBA_DISABLE_JIT is set: Numba cannot compile kernels", "Unset it."


def _of_kernels(facts: dict[str, Any]) -> Iterator[tuple[str, str]]:
    counts, why = facts["kernel_counts"], facts["kernels"]
    if counts["source"] == "missing":
        yield f"No kernels: {why}, and Numba is not installed", "pip install 'pointray[jit]'"
    elif counts["source"] != "library" and "POINTRAY_" not in why:
        advice = f"Install a wheel that contains them, or build one: {address_of('install.html')}"
        yield f"Kernels are compiled when they are first needed: {why}", advice
    elif counts["outdated"]:
        yield (
            f"{counts['outdated']} kernels of the library were built from other sources and are compiled on first use",
            "Reinstall pointray; in a clone run: make kernels",
        )


def _of_packages(facts: dict[str, Any]) -> Iterator[tuple[str, str]]:
    groups = {"": facts["packages"], **{name: extra["packages"] for name, extra in facts["extras"].items()}}
    for extra, packages in groups.items():
        for name, about in packages.items():
            version, least = about["version"], about["least"]
            if version is None and not extra:
                yield f"{name} is not installed", f"pip install '{name}{f'>={least}' if least else ''}'"
            elif version is not None and least is not None and _numbers(version) < _numbers(least):
                yield f"{name} {version} is too old", f"pip install '{name}>={least}'"
        missing = [name for name, about in packages.items() if about["version"] is None]
        if extra and 0 < len(missing) < len(packages):
            yield f"{', '.join(missing)} of the extra {extra!r} is not installed", f"pip install 'pointray[{extra}]'"


def _numbers(version: str) -> list[int]:
    """Return the release of a version as numbers, without zeros at the end: 2.0rc1 gives [2]."""
    numbers = [int(part) for part in re.match(r"[\d.]*", version)[0].split(".") if part]  # type: ignore[index]
    while numbers and not numbers[-1]:
        numbers.pop()
    return numbers


def _of_machine(facts: dict[str, Any]) -> Iterator[tuple[str, str]]:
    quota, free = facts["cpu_quota"], facts["memory"]["available"]
    if isinstance(quota, float) and isinstance(facts["threads"], int) and quota < facts["threads"]:
        yield (
            f"This process may use {quota:g} CPUs, but pointray starts {facts['threads']} threads",
            f"Set POINTRAY_THREADS={max(1, round(quota))}, or give the container more CPUs.",
        )
    if free is not None and free < LITTLE_MEMORY:
        advice = "Close other programs, or read fewer points with --every or --max-points."
        yield (
            f"Only {in_units(free)} of memory are available",
            f"{advice} {address_of('troubleshooting.html#out-of-memory')}",
        )


def _of_cache(facts: dict[str, Any]) -> Iterator[tuple[str, str]]:
    if not facts["cache"]["writable"]:
        yield (
            f"The cache folder {facts['cache']['folder']} is not writable: nothing that is prepared is kept",
            "Set POINTRAY_CACHE to a folder that you can write to.",
        )


def _of_browser(facts: dict[str, Any]) -> Iterator[tuple[str, str]]:
    name = facts["browser"]
    if name is None or name in TEXT_BROWSERS:
        known = "No browser was found" if name is None else f"Only a text browser was found ({name})"
        yield f"{known}: `pointray view` cannot open its page", REMOTE
