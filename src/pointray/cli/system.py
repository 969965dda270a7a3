"""pointray info --system: facts about this installation, for bug reports. Problems in them are found in `problems`."""

from __future__ import annotations

import json
import os
import platform
import re
import sys
import tempfile
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from importlib import metadata
from pathlib import Path, PurePosixPath
from typing import Any

import platformdirs

from ..base.dependencies import PACKAGE, ROOT
from ..base.memory import CGROUPS, OWN_CGROUPS, available_memory, in_units
from ..base.version import __version__

CPUINFO = Path("/proc/cpuinfo")
UNKNOWN = "unknown"  # how a fact begins that could not be found
# What the optional dependency groups of pyproject.toml enable.
ENABLES = {
    "jit": "kernels compiled on this machine, if there is no library for it",
    "plot": "matplotlib's colour maps; bench --plot",
    "files": "EXR and HDR images, .zst files, SPZ 4",
    "e57": "E57 files",
    "mesh": "meshes (OBJ, STL, glTF, OFF, triangles of PLY); Model.to_mesh",
    "pcd": "compressed PCD files",
    "remote": "files on servers (http, s3, gs)",
    "notebook": "the viewer as a notebook widget, without a port",
    "film": "MP4 films",
    "geo": "exact projection of coordinates in degrees",
    "denoise": "--denoise",
    "cluster": "--workers and --cluster (Dask)",
}
# Flags of /proc/cpuinfo that each level adds.
LEVELS = {
    "x86-64-v2": "cx16 lahf_lm pni popcnt sse4_1 sse4_2 ssse3",
    "x86-64-v3": "abm avx avx2 bmi1 bmi2 f16c fma movbe xsave",
    "x86-64-v4": "avx512bw avx512cd avx512dq avx512f avx512vl",
}
REQUIREMENT = re.compile(r"([\w.-]+)(?:\[[^]]*\])?(?:>=([\d.]+))?")


def describe_system() -> dict[str, Any]:
    """Return facts about this installation by name, as JSON values; a fact that cannot be found begins with "unknown".

    The home folder is written as ~. "problems" is a list of dicts with the keys problem and advice.
    """
    from .problems import find_problems

    facts = {name: _guarded(probe) for name, probe in PROBES.items()}
    facts["problems"] = [{"problem": problem, "advice": advice} for problem, advice in find_problems(facts)]
    return _without_home(facts)


def _guarded(probe: Callable[[], Any]) -> Any:
    try:
        return probe()
    except Exception as error:  # whatever is wrong with the machine, the other facts are printed
        return f"{UNKNOWN} ({type(error).__name__}: {' '.join(str(error).split())})"


def _without_home(value: Any) -> Any:
    """Return a JSON value with ~ in place of the path of the home folder in all texts."""
    if isinstance(value, dict):
        return {name: _without_home(one) for name, one in value.items()}
    if isinstance(value, list):
        return [_without_home(one) for one in value]
    home = os.path.expanduser("~")
    known = isinstance(value, str) and len(home) > 1
    return re.sub(rf"{re.escape(home)}(?=$|[\\/:;,) ])", "~", value) if known else value


def _processor() -> str:
    """Return the model of the processor."""
    with suppress(OSError):
        model = re.search(r"^model name\s*: (.+)$", CPUINFO.read_text(), re.MULTILINE)
        if model:
            return model[1].strip()
    return platform.processor() or platform.machine()


def _level() -> str | None:
    """Return the x86-64 level of the processor, such as "x86-64-v3"; None for others, or if its flags are unknown."""
    flags = re.search(r"^flags\s*:(.+)$", CPUINFO.read_text(), re.MULTILINE) if CPUINFO.exists() else None
    if flags is None:
        return None
    has, level = set(flags[1].split()), "x86-64-v1"
    for name, needed in LEVELS.items():
        if not has.issuperset(needed.split()):
            break
        level = name
    return level


def _why() -> str:
    from ..engine.jit.library import choice

    return choice()[1]


def _kernels() -> dict[str, Any]:
    """Return the number of kernels in the library, of those built from other sources, and of those in Numba's cache.

    "source" says where kernels come from: library, compiled on demand, or missing (neither a library nor Numba).
    """
    from ..engine.jit.library import FOLDER, MANIFEST, choice

    library, _ = choice()
    names: list[str] = []
    if library is not None:
        names = list(json.loads((FOLDER / MANIFEST).read_text())["kernels"])
    files = [ROOT.joinpath(*name.split(".")[1:-1]).with_suffix(".py") for name in names]
    good = sum(library.find(name, file) is not None for name, file in zip(names, files, strict=True) if library)
    source = "library" if good else "compiled on demand" if _version("numba") else "missing"
    return {
        "source": source,
        "in_library": good,
        "outdated": len(names) - good,
        "compiled_here": sum(1 for _ in _cache().glob("kernels-*/*/*.nbi")),
    }


def _threads() -> int:
    from ..engine.jit import thread_count

    return thread_count()


def cpu_quota() -> float | None:
    """Return the number of CPUs that control groups (cgroup version 2) allow this process; None if not limited."""
    quotas = []
    own = re.search(r"^0::/(.*)$", OWN_CGROUPS.read_text(), re.MULTILINE) if OWN_CGROUPS.exists() else None
    path = PurePosixPath(own[1] if own else "")
    for group in (path, *path.parents):
        with suppress(OSError, ValueError):
            quota, period = (CGROUPS / group / "cpu.max").read_text().split()  # ValueError for "max", no limit
            quotas.append(int(quota) / int(period))
    return min(quotas, default=None)


def _memory() -> dict[str, Any]:
    total = None
    with suppress(AttributeError, OSError, ValueError):  # unknown on Windows
        total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return {"total": total, "available": available_memory()}


def _cache() -> Path:
    return Path(os.environ.get("POINTRAY_CACHE") or platformdirs.user_cache_dir("pointray", appauthor=False))


def _cache_facts() -> dict[str, Any]:
    """Return the folder of compiled kernels and models, its size in bytes, and whether it can be written."""
    folder, size = _cache(), 0
    for place, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                size += os.lstat(os.path.join(place, name)).st_size
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    return {"folder": str(folder), "bytes": size, "writable": _is_writable(existing)}


def _is_writable(folder: Path) -> bool:
    """Return whether a file can be created in a folder; permissions do not tell, for example in /proc."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _requirements(extra: str) -> dict[str, str | None]:
    """Return the packages of an optional dependency group, or with "" those always needed: least version by name."""
    found: dict[str, str | None] = {}
    for text in metadata.requires(PACKAGE) or ():
        condition = text.partition(";")[2]
        group = re.search(r"extra == ['\"]([\w-]+)['\"]", condition)
        until = re.search(r"python_version < ['\"]3\.(\d+)['\"]", condition)
        if (group[1] if group else "") != extra or (until and sys.version_info[1] >= int(until[1])):
            continue
        name = REQUIREMENT.match(text)
        if name and "platform_machine" not in condition:
            found[name[1]] = name[2]
    return found


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _packages(extra: str = "") -> dict[str, Any]:
    """Return version and least supported version of each package of an optional dependency group. extra : see above"""
    return {name: {"version": _version(name), "least": least} for name, least in _requirements(extra).items()}


def _extras() -> dict[str, Any]:
    return {
        name: {"packages": _packages(name), "enables": what, "install": f"pip install 'pointray[{name}]'"}
        for name, what in ENABLES.items()
    }


def _browser() -> str | None:
    """Return the name of the browser that `pointray view` opens; None if there is none."""
    try:
        found = webbrowser.get()
    except webbrowser.Error:
        return None
    return str(getattr(found, "name", "") or type(found).__name__)


def _variables() -> dict[str, str]:
    numba = "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_DISABLE_JIT"
    return {name: value for name, value in sorted(os.environ.items()) if name.startswith("POINTRAY_") or name in numba}


PROBES: dict[str, Callable[[], Any]] = {
    "pointray": lambda: __version__,
    "python": platform.python_version,
    "system": platform.platform,
    "processor": _processor,
    "machine": platform.machine,
    "level": _level,
    "kernels": _why,
    "kernel_counts": _kernels,
    "threads": _threads,
    "cpus": os.cpu_count,
    "cpu_quota": cpu_quota,
    "memory": _memory,
    "cache": _cache_facts,
    "browser": _browser,
    "variables": _variables,
    "packages": _packages,
    "extras": _extras,
}


def show_system(facts: dict[str, Any]) -> None:
    """Print the facts of `describe_system` as tables, and the problems with advice, at most 80 characters wide."""
    from rich.console import Console
    from rich.padding import Padding
    from rich.text import Text

    from .printable import printable
    from .tables import table_of

    console = Console(highlight=False, soft_wrap=False)
    console.width = min(console.width, 80)
    console.print(table_of([[name, text] for name, text in _rows(facts).items()]))
    if isinstance(facts["extras"], dict):
        rows = [[name, *_shown_extra(about)] for name, about in facts["extras"].items()]
        console.print("", table_of([["extra", "packages", "enables"], *rows], heads=True), sep="\n")
        console.print("\nInstall an extra: pip install 'pointray[EXTRA]'")
    console.print()
    if not facts["problems"]:
        console.print("No problems found.")
    for number, found in enumerate(facts["problems"], 1):
        console.print(Text(f"Problem {number}: {printable(found['problem'])}"))
        console.print(Padding(Text(printable(found["advice"])), (0, 0, 0, 4)))


def _rows(facts: dict[str, Any]) -> dict[str, str]:
    """Return the rows of the first table, text by name; facts that were not found are shown as they are."""
    rows = {name: str(facts[name]) for name in ("pointray", "python", "system")}
    rows["processor"] = f"{facts['processor']} ({facts['machine']}, level: {facts['level'] or UNKNOWN})"
    rows["kernels"] = str(facts["kernels"])
    counts, memory, cache = facts["kernel_counts"], facts["memory"], facts["cache"]
    rows[""] = str(counts)
    if isinstance(counts, dict):
        rows[""] = f"{counts['source']} ({counts['in_library']} kernels, {counts['outdated']} outdated), "
        rows[""] += f"{counts['compiled_here']} compiled here"
    rows["threads"] = f"{facts['threads']} of {facts['cpus']} CPUs"
    if isinstance(memory, dict):
        memory = ", ".join(f"{UNKNOWN if size is None else in_units(size)} {name}" for name, size in memory.items())
    if isinstance(cache, dict):
        state = "writable" if cache["writable"] else "not writable"
        cache = f"{cache['folder']}: {in_units(cache['bytes'])}, {state}"
    rows |= {"memory": str(memory), "cache": str(cache), "browser": str(facts["browser"] or "none")}
    if facts["variables"] and isinstance(facts["variables"], dict):
        rows["variables"] = " ".join(f"{name}={value}" for name, value in facts["variables"].items())
    packages = facts["packages"]
    rows["packages"] = _shown_packages(packages) if isinstance(packages, dict) else str(packages)
    return rows


def _shown_extra(about: dict[str, Any]) -> list[str]:
    missing = [name for name, package in about["packages"].items() if package["version"] is None]
    if len(missing) == len(about["packages"]):
        return ["not installed", about["enables"]]
    return [_shown_packages(about["packages"]), about["enables"]]


def _shown_packages(packages: dict[str, Any]) -> str:
    return ", ".join(f"{name} {package['version'] or 'not installed'}" for name, package in packages.items())
