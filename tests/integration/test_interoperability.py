"""The programs of docs/interoperability.md run."""

import re
import warnings

import pytest

import pointray as pr
from helpers.places import ROOT

BLOCKS = re.findall(
    r"^```python\n(.*?)^```$", (ROOT / "docs" / "interoperability.md").read_text(), re.MULTILINE | re.DOTALL
)
NEEDED = "pandas", "pyvista", "open3d", "xarray", "skimage", "trimesh"


def test_there_are_programs():
    assert len(BLOCKS) >= 5


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_programs_of_the_document_run(number, tmp_path, monkeypatch):
    for name in NEEDED:
        pytest.importorskip(name, exc_type=ImportError)
    monkeypatch.chdir(tmp_path)
    pr.write("scan.ply", pr.procedural("statue", 3000))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        exec(compile(BLOCKS[number], f"docs/interoperability.md, program {number}", "exec"), {"__name__": "program"})
