"""The installation page lists the extras of `pyproject.toml` with their packages, and the systems of wheels."""

import re
import tomllib

from helpers.places import ROOT
from native.targets import SYSTEMS

PAGE = (ROOT / "docs" / "install.md").read_text()
DEVELOPMENT = {"dev", "docs", "wheel", "release"}


def test_the_page_lists_all_extras_and_their_packages():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    needed = {
        name: {re.match(r"[\w.-]+", package)[0] for package in packages}
        for name, packages in extras.items()
        if name not in DEVELOPMENT
    }
    rows = re.findall(r"^\| `(\w+)` \|.*\| ([^|]+) \|$", PAGE, re.MULTILINE)
    assert {name: set(packages.split(", ")) for name, packages in rows} == needed


def test_the_page_names_all_systems_of_wheels():
    assert [name for name in SYSTEMS if name not in PAGE] == []
