"""Docstrings of the public interface: their examples run, and they describe parameters, results and use."""

from __future__ import annotations

import doctest
import inspect
import re
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pointray as pr

# Results, which callers do not create: their attributes are documented.
RESULTS = {
    "Baked",
    "Flaws",
    "FormatFacts",
    "Hits",
    "Layers",
    "NormalsCheck",
    "Prepared",
    "SceneFile",
    "StaleLightWarning",
} | {"Strays", "Viewer"}
# Methods without examples: `remade` is deprecated, `open_browser` needs a browser, only the package calls the others.
BRIEF = {"align_tree", "check_whole", "open_browser", "portable", "record", "remade", "snapshot", "tables"}
SECTION = r"^{}\n-+\n(.*?)(?=^\w[\w ]*\n--|\Z)"


def members(owner: type) -> Iterator[tuple[str, Any]]:
    """Return the public methods and properties of a class of this package, also inherited ones."""
    for name, _ in inspect.getmembers_static(owner):
        home = next((base for base in owner.__mro__ if name in vars(base)), None)
        if home is None or name.startswith("_") or not home.__module__.startswith("pointray"):
            continue
        value = inspect.getattr_static(owner, name)
        if inspect.isfunction(value) or isinstance(value, classmethod | property | cached_property):
            yield f"{owner.__name__}.{name}", getattr(value, "__func__", value)


PUBLIC = {name: getattr(pr, name) for name in pr.__all__ if name != "__version__"}
MEMBERS = {name: value for owner in PUBLIC.values() if inspect.isclass(owner) for name, value in members(owner)}
# Properties have a sentence: their use is obvious.
DOCUMENTED = {
    name: value
    for name, value in {**PUBLIC, **MEMBERS}.items()
    if callable(value) and name.rpartition(".")[2] not in BRIEF
}
TEXTS = {name: inspect.getdoc(value) or "" for name, value in {**PUBLIC, **MEMBERS}.items()}


def section(name: str, title: str) -> str:
    """Return a section of a docstring, or an empty string."""
    found = re.search(SECTION.format(title), TEXTS[name], re.MULTILINE | re.DOTALL)
    return found[1] if found else ""


def documented(text: str) -> list[str]:
    """Return the names of the parameters in a section."""
    heads = [line.split(" : ")[0] for line in text.splitlines() if line and not line.startswith(" ")]
    return [name.strip(" *") for head in heads for name in head.split(",")]


def parameters(value: Any) -> list[str]:
    """Return the names of the parameters of a function or class, without private ones."""
    names = inspect.signature(value).parameters
    return [name for name in names if name not in ("self", "cls") and not name.startswith("_")]


def run(name: str, text: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the examples of a text in a folder."""
    monkeypatch.chdir(folder)
    test = doctest.DocTestParser().get_doctest(text, {"pr": pr, "np": np}, name, None, None)
    report: list[str] = []
    result = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(test, out=report.append)
    assert result.attempted and not result.failed, "".join(report)


@pytest.mark.parametrize("name", [name for name, text in TEXTS.items() if ">>>" in text])
def test_examples_of_docstrings_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(name, TEXTS[name], tmp_path, monkeypatch)


def test_the_example_of_the_package_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pr.write(tmp_path / "scan.ply", pr.procedural("sphere", 1000))
    run("pointray", pr.__doc__ or "", tmp_path, monkeypatch)
    assert (tmp_path / "scan.png").exists()


@pytest.mark.parametrize("name", DOCUMENTED)
def test_docstrings_describe_parameters_and_results(name: str) -> None:
    value = DOCUMENTED[name]
    if name in RESULTS:
        assert documented(section(name, "Attributes")) == list(inspect.get_annotations(value))
    else:
        assert documented(section(name, "Parameters")) == parameters(value)
    if not inspect.isclass(value) and inspect.signature(value).return_annotation != "None":
        assert section(name, "Returns")
    assert ">>>" in section(name, "Examples")


@pytest.mark.parametrize("name", TEXTS)
def test_docstrings_begin_with_a_sentence(name: str) -> None:
    summary, _, rest = TEXTS[name].partition("\n")
    assert summary.endswith(".") and (not rest or rest.startswith("\n"))


def test_broken_examples_are_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for text in (">>> len(pr.procedural('sphere', 100))\n99", ">>> pr.nothing", "No example."):
        with pytest.raises(AssertionError):
            run("broken", text, tmp_path, monkeypatch)
