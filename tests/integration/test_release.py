"""Files of a release: one version, consistent requirements, parts of `.ci/run`; linters where they are installed."""

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import pointray
from helpers.places import ROOT

yaml = pytest.importorskip("yaml")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
RECIPE = (ROOT / "packaging" / "conda" / "recipe.yaml").read_text()
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))
CONDA_NAMES = {"lazy_loader": "lazy-loader", "laspy[lazrs]": "laspy"}
PARTS = set(re.findall(r"^run_(\w+)\(\)", (ROOT / ".ci" / "run").read_text(), re.MULTILINE))


def test_the_version_is_the_same_everywhere():
    version = pointray.__version__
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == version
    assert yaml.safe_load(RECIPE)["context"]["version"] == version
    assert re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)[1] == version
    assert "version" in PROJECT["dynamic"]


def test_the_recipe_requires_what_the_package_requires():
    recipe = yaml.safe_load(RECIPE)
    words = [re.fullmatch(r"([\w\[\]-]+)(>=[\d.]+)(; .*)?", line).groups() for line in PROJECT["dependencies"]]
    wanted = {f"{CONDA_NAMES.get(name, name)} {bound}" for name, bound, _ in words}
    assert set(recipe["requirements"]["run"]) == {*wanted, "lazrs-python", "python >=${{ python_min }}"}
    assert PROJECT["requires-python"] == f">={recipe['context']['python_min']}"


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_workflows_run_parts_that_exist(path: Path):
    for job in yaml.safe_load(path.read_text())["jobs"].values():
        for step in job.get("steps", []):
            words = step.get("run", "").split()
            if "bash" in words:
                assert words[1] == ".ci/run" and words[2:] and set(words[2:]) <= PARTS, step
    assert {"check", "lint", "demo", "wheel", "wheels", "test", "pure", "install"} <= PARTS


def test_unknown_parts_are_refused():
    done = subprocess.run(["bash", ".ci/run", "demos"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.startswith("unknown part: demos\n")
    assert set(re.findall(r"^  (\w+)  ", done.stderr, re.MULTILINE)) == PARTS


def test_every_form_asks_for_the_system():
    forms = [yaml.safe_load(path.read_text()) for path in FORMS if path.name != "config.yml"]
    assert len(forms) == 3
    for form in forms:
        questions = {question["id"]: question["attributes"] for question in form["body"]}
        assert "pointray info --system" in questions["system"]["description"], form["name"]
        assert all(question["label"] for question in questions.values()) and form["description"]


def test_the_citation_names_the_paper():
    paper, *_ = yaml.safe_load((ROOT / "CITATION.cff").read_text())["references"]
    assert paper["year"] == 2005 and [author["family-names"] for author in paper["authors"]] == ["Wald", "Seidel"]


@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
def test_the_linters_find_nothing():
    """As `make lint-release`, without installing anything."""
    folder = Path(sys.executable).parent
    if not all((folder / name).exists() for name in ("jactionlint", "hadolint", "shellcheck")):
        pytest.skip("pip install -e '.[release]'")
    stamps = [f"--old-file=.venv/{name}" for name in ("installed", "tools", "release")]
    done = subprocess.run(
        ["make", "lint-release", f"BIN={folder}", *stamps], cwd=ROOT, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr
