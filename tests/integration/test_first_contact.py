"""What new users meet: `pointray` without arguments, `info --system`, and messages that link to the manual."""

from __future__ import annotations

import inspect
import json
import re
import shlex
import subprocess
import sys
import tomllib
import webbrowser
from pathlib import Path
from typing import Any

import pytest

import pointray as pr
from helpers.places import ROOT
from pointray.base.manual import MANUAL, PAGES, REPORT, address_of, noted, page_about, with_note
from pointray.cli import execute, greeting, problems, system

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# A program that prints which heavy modules `pointray` without arguments has imported.
LIGHT = """
import sys
from pointray.cli import execute
status = execute([])
print(status, {"numpy", "typer", "rich", "numba", "scipy"} & set(sys.modules))
"""


def facts_of(**changes: Any) -> dict[str, Any]:
    """Return facts of a good installation, with changes."""
    packages = {"numpy": {"version": "2.4.6", "least": "2.0"}}
    extra = {"packages": {"pye57": {"version": None, "least": "0.4"}}, "enables": "E57", "install": "pip"}
    counts = {"source": "library", "in_library": 117, "outdated": 0, "compiled_here": 0}
    good = {
        "pointray": "0.1.0",
        "python": "3.11.7",
        "system": "Linux",
        "processor": "CPU",
        "machine": "x86_64",
        "level": "x86-64-v3",
        "kernels": "compiled for x86-64-v3",
        "kernel_counts": counts,
        "threads": 2,
        "cpus": 2,
        "cpu_quota": None,
        "memory": {"total": 8 * 2**30, "available": 4 * 2**30},
        "cache": {"folder": "/cache", "bytes": 0, "writable": True},
        "browser": "firefox",
        "variables": {},
        "packages": packages,
        "extras": {"e57": extra},
    }
    return good | changes


# ------------------------------------------------------------------------------------------------- the greeting


def test_without_arguments_examples_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute([]) == 0
    out, err = capsys.readouterr()
    lines = out.splitlines()
    assert err == "" and max(map(len, lines)) <= 80
    assert sum(line.startswith("  pointray ") for line in lines) == 5
    assert MANUAL in out and "pointray --help" in out


def test_the_greeting_imports_nothing_heavy() -> None:
    done = subprocess.run([sys.executable, "-c", LIGHT], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "0 set()"


@pytest.mark.long
@pytest.mark.parametrize("command", greeting.EXAMPLES)
def test_the_examples_run(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    pr.write("scan.ply", pr.procedural("statue", 2000))
    program, *words = shlex.split(command)
    assert program == "pointray"
    if words[0] == "view":
        assert words == ["view", "scan.ply"]  # others test that it opens
        return
    assert execute(words) == 0


# ------------------------------------------------------------------------------------------------- info --system


def test_the_system_is_described(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["info", "--system"]) == 0
    out, err = capsys.readouterr()
    assert err == "" and max(map(len, out.splitlines())) <= 80
    for word in (pr.__version__, "kernels", "memory", "cache", "browser", "numpy", *system.ENABLES):
        assert word in out
    assert str(Path.home()) not in out
    assert "unknown (" not in out and ("Problem 1: " in out) != ("No problems found." in out)


def test_each_extra_is_described(capsys: pytest.CaptureFixture[str]) -> None:
    assert set(system.ENABLES) == set(PROJECT["optional-dependencies"]) - {"dev", "docs", "release", "wheel"}
    assert execute(["info", "--system", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    for name, about in facts["extras"].items():
        assert about["packages"] and about["install"] == f"pip install 'pointray[{name}]'"
    assert facts["packages"]["numpy"]["version"] and facts["packages"]["numpy"]["least"] == "2.0"


def test_it_never_fails(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Each fact, and then all of them, cannot be found."""

    def broken() -> None:
        raise OSError(5, "Input/output error")

    alone = [{name: broken} for name in system.PROBES]
    for changes in (*alone, dict.fromkeys(system.PROBES, broken)):
        probes = {name: (lambda name=name: facts_of()[name]) for name in system.PROBES}
        monkeypatch.setattr(system, "PROBES", probes | changes)
        assert execute(["info", "--system"]) == 0
        out = "".join(capsys.readouterr().out.split())
        assert "unknown(OSError" in out and REPORT in out, changes
        assert execute(["info", "--system", "--json"]) == 0
        assert len(json.loads(capsys.readouterr().out)["problems"]) >= len(changes)


def test_the_home_folder_is_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/ada")
    monkeypatch.setenv("USERPROFILE", "/home/ada")
    monkeypatch.setattr(system, "PROBES", {"a": lambda: ["/home/ada/x: /home/ada", {"b": "/home/adam /x/home/ada/y"}]})
    assert system.describe_system()["a"][0] == "~/x: ~"
    assert system.describe_system()["a"][1] == {"b": "/home/adam /x~/y"}


def test_levels_of_processors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system, "CPUINFO", tmp_path / "cpuinfo")
    assert system._level() is None
    flags = list(system.LEVELS.values())
    for count, level in enumerate(["x86-64-v1", *system.LEVELS]):
        system.CPUINFO.write_text(f"model name\t: Fast CPU\nflags\t\t: fpu {' '.join(flags[:count])}\n")
        assert system._level() == level
    assert system._processor() == "Fast CPU"


def test_limits_of_control_groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system, "CGROUPS", tmp_path)
    monkeypatch.setattr(system, "OWN_CGROUPS", tmp_path / "own")
    assert system.cpu_quota() is None
    (tmp_path / "own").write_text("0::/a/b\n")
    for folder, text in {"a/b": "max 100000", "a": "150000 100000", ".": "400000 100000"}.items():
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
        (tmp_path / folder / "cpu.max").write_text(text)
    assert system.cpu_quota() == 1.5


def test_a_missing_browser_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> None:
        raise webbrowser.Error("none")

    monkeypatch.setattr(webbrowser, "get", none)
    assert system._browser() is None
    monkeypatch.setattr(webbrowser, "get", lambda: webbrowser.GenericBrowser("firefox"))
    assert system._browser() == "firefox"


def test_a_folder_that_is_a_file_is_not_writable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("x")
    monkeypatch.setenv("POINTRAY_CACHE", str(tmp_path / "file" / "cache"))
    assert system._cache_facts()["writable"] is False
    monkeypatch.setenv("POINTRAY_CACHE", str(tmp_path / "new" / "cache"))
    assert system._cache_facts() == {"folder": str(tmp_path / "new" / "cache"), "bytes": 0, "writable": True}


def test_a_good_installation_has_no_problems(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    assert problems.find_problems(facts_of()) == []
    system.show_system(facts_of(problems=[]))
    assert "No problems found." in capsys.readouterr().out


COUNTS = {"source": "compiled on demand", "in_library": 0, "outdated": 0, "compiled_here": 0}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cache": {"folder": "/cache", "bytes": 0, "writable": False}}, "/cache is not writable"),
        (
            {"kernel_counts": COUNTS, "kernels": "no compiled kernels"},
            "compiled when they are first needed: no compiled kernels",
        ),
        ({"kernel_counts": COUNTS | {"source": "missing"}}, "Numba is not installed"),
        ({"kernel_counts": COUNTS | {"source": "library", "in_library": 3, "outdated": 2}}, "2 kernels"),
        ({"memory": {"total": 8 * 2**30, "available": 2**30}}, "Only 1.0 GiB"),
        ({"packages": {"numpy": {"version": "1.26.4", "least": "2.0"}}}, "numpy 1.26.4 is too old"),
        ({"packages": {"numpy": {"version": None, "least": "2.0"}}}, "numpy is not installed"),
        ({"browser": None}, "No browser"),
        ({"browser": "w3m"}, "text browser was found (w3m)"),
        ({"cpu_quota": 1.5}, "1.5 CPUs"),
        ({"variables": {"POINTRAY_THREAD": "2"}}, "did you mean 'POINTRAY_THREADS'"),
        ({"variables": {"POINTRAY_THREADS": "many"}}, "POINTRAY_THREADS=many is invalid"),
        ({"variables": {"POINTRAY_THREADS": "1"}}, "POINTRAY_THREADS=1, but there are 2 CPUs"),
        ({"variables": {"POINTRAY_CHECK": "1"}}, "POINTRAY_CHECK"),
        ({"variables": {"POINTRAY_KERNELS": "jit"}}, "POINTRAY_KERNELS=jit"),
        ({"variables": {"POINTRAY_KERNELS": "fast"}}, "POINTRAY_KERNELS=fast is invalid"),
        ({"variables": {"NUMBA_DISABLE_JIT": "1"}}, "NUMBA_DISABLE_JIT"),
        ({"processor": "unknown (OSError: x)"}, "processor: unknown (OSError: x)"),
    ],
)
def test_problems_are_found(changes: dict[str, Any], words: str) -> None:
    (found,) = problems.find_problems(facts_of(**changes))
    assert words in found[0] and found[1]


def test_an_extra_that_is_partly_installed_is_a_problem() -> None:
    packages = {"dask": {"version": "2025.1.0", "least": "2025.1"}, "distributed": {"version": None, "least": "2025.1"}}
    (found,) = problems.find_problems(facts_of(extras={"cluster": {"packages": packages}}))
    assert found == ("distributed of the extra 'cluster' is not installed", "pip install 'pointray[cluster]'")


# ----------------------------------------------------------------------------------------- links to the manual


def test_the_address_is_that_of_the_project() -> None:
    assert PROJECT.get("urls", {}).get("Documentation", MANUAL) == MANUAL


@pytest.mark.parametrize("page", [*PAGES.values(), REPORT])
def test_linked_pages_exist(page: str) -> None:
    name, _, anchor = page.partition("#")
    text = (ROOT / "docs" / name).with_suffix(".md").read_text()
    assert not anchor or re.search(rf"^\({anchor}\)=\n\n?## ", text, re.MULTILINE)


def test_addresses_in_the_code_exist() -> None:
    """Pages that are named elsewhere than in PAGES."""
    for file in (ROOT / "src").rglob("*.py"):
        text = file.read_text()
        written = re.escape(f"{MANUAL}/page/") + r"([\w/#-]+\.html[\w#-]*)"
        for page in re.findall(r"address_of\(['\"](.+?)['\"]\)", text) + re.findall(written, text):
            test_linked_pages_exist(page)


def test_public_docstrings_name_addresses_instead_of_files() -> None:
    public = [getattr(pr, name) for name in pr.__all__]
    parts = [member for each in public if inspect.isclass(each) for member in vars(each).values()]
    for each in [*public, *parts]:
        assert "docs/" not in (inspect.getdoc(each) or ""), each


PROPERTIES = "property float x\nproperty float y\nproperty float z\n"
CUT = f"ply\nformat ascii 1.0\nelement vertex 9\n{PROPERTIES}end_header\n1 2 3\n"


@pytest.mark.parametrize(
    ("name", "text", "options", "page"),
    [
        ("a.docx", "text", [], "troubleshooting.html#unknown-format"),
        ("a.ply", "text", [], "troubleshooting.html#unknown-format"),
        ("a.xyz", "", [], "troubleshooting.html#no-points"),
        ("a.ply", CUT, ["--strict"], "troubleshooting.html#truncated-files"),
        ("a.ply", CUT.replace("9", "0"), [], "troubleshooting.html#no-points"),
    ],
)
def test_messages_name_a_page(
    name: str, text: str, options: list[str], page: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_text(text)
    assert execute(["info", str(tmp_path / name), *options]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.endswith(f"; see {address_of(page)}\n")
    with pytest.raises(ValueError) as caught:
        pr.read(tmp_path / name, strict=bool(options))
    assert caught.value.__notes__ == [f"See {address_of(page)}"]
    assert address_of(page) not in str(caught.value)


def test_errors_of_scene_files_name_their_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.toml").write_text("[models\n")
    assert execute(["render", str(tmp_path / "a.toml"), "-o", str(tmp_path / "a.png")]) == 2
    assert capsys.readouterr().err.endswith(f"; see {address_of('scenes.html')}\n")
    with pytest.raises(ValueError) as caught:
        pr.load_scene(tmp_path / "a.toml")
    assert caught.value.__notes__ == [f"See {address_of('scenes.html')}"]


def test_other_messages_name_none(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["info", "absent.ply"], ["sculpt"], ["info", "--loudly"], ["info", "--system", "a.ply"]):
        assert execute(words) == 2
        assert MANUAL not in capsys.readouterr().err
    assert page_about("threads must be at least 1, got 0") is None


def test_a_note_is_added_once() -> None:
    error = ValueError("a.ply: is cut off")
    assert with_note(with_note(error)) is error and len(error.__notes__) == 1
    with pytest.raises(ValueError) as caught, noted(), noted():
        raise ValueError("a.ply: is cut off")
    assert len(caught.value.__notes__) == 1
    assert not hasattr(with_note(ValueError("fov must be positive")), "__notes__")
