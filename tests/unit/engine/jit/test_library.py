"""The library of compiled kernels: which one is used, and what happens if none is suitable."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import pointray
from helpers.marks import long
from helpers.native_library import PACKAGE, needs_library
from pointray.base.manual import address_of
from pointray.cli import BAD_INPUT, execute
from pointray.engine.jit import library

# A model and a picture of it, and how many kernels came from each source.
PICTURE = """
import hashlib, sys
{before}
import pointray as pr
from pointray.engine import jit
model = pr.Model(pr.procedural("torus", 3000).positions)
scene = pr.Scene()
scene.add(model)
scene.add_light(pr.SunLight((1, 1, -2)))
image = pr.render(scene, pr.frame(scene, size=(64, 48)), pr.Settings("phong"))
counts = [sum(k.in_library is not None for k in jit.KERNELS.values()), jit.compilations()]
print(hashlib.sha256(image.tobytes()).hexdigest()[:16], *counts, sys.modules.get("numba"))
"""
WITHOUT_NUMBA = "sys.modules.update(numba=None, llvmlite=None)"


def run(code: str, status: int = 0, **variables: str) -> tuple[str, str]:
    """Run a program and return its output and errors."""
    environment = {**os.environ, **variables}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == status, done.stderr
    return done.stdout, done.stderr


@needs_library
def test_a_picture_needs_no_numba():
    told, _ = run(PICTURE.format(before=WITHOUT_NUMBA))
    _, kernels, compiled, numba = told.split()
    assert int(kernels) > 60 and (compiled, numba) == ("0", "None")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the libraries, which is the folder that is searched."""
    copy = tmp_path / "native"
    shutil.copytree(library.FOLDER, copy)
    monkeypatch.setattr(library, "FOLDER", copy)
    monkeypatch.setattr(library, "CHECK", False)
    monkeypatch.delenv("POINTRAY_KERNELS", raising=False)
    return copy


def chosen() -> tuple[library.Library | None, str]:
    """Return the current choice."""
    return library.choice.__wrapped__()


def files_in(folder: Path) -> list[Path]:
    """The libraries in a folder."""
    return [path for path in folder.iterdir() if path.name != library.MANIFEST]


@needs_library
def test_the_best_level_of_this_processor_is_used(folder, monkeypatch):
    found, why = chosen()
    assert found is not None and why == f"compiled for {found.level}"
    monkeypatch.setenv("POINTRAY_KERNELS", "compiled")
    assert chosen()[1] == why
    monkeypatch.setenv("POINTRAY_KERNELS", "jit")
    assert chosen() == (None, "POINTRAY_KERNELS=jit")
    monkeypatch.setenv("POINTRAY_KERNELS", "auto")
    monkeypatch.setattr(library, "CHECK", True)
    assert chosen()[0] is None and "POINTRAY_CHECK" in chosen()[1]


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def changed(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def emptied(path: Path) -> None:
    path.write_bytes(b"")


def a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


@needs_library
@pytest.mark.parametrize("damage", [truncated, changed, emptied, a_folder, Path.unlink])
def test_a_damaged_library_is_not_loaded(folder, damage):
    for path in files_in(folder):
        damage(path)
    found, why = chosen()
    assert found is None and why.startswith("the compiled kernels cannot be used: ")
    assert str(folder) in why


@needs_library
@pytest.mark.parametrize(
    "change",
    [
        lambda manifest: manifest.update(format=0),
        lambda manifest: manifest.pop("kernels"),
        lambda manifest: manifest.update(libraries=[]),
        lambda manifest: manifest.update(records=3),
        lambda manifest: manifest["libraries"].update({level: {} for level in manifest["libraries"]}),
    ],
)
def test_a_damaged_manifest_is_reported(folder, change):
    manifest = json.loads((folder / library.MANIFEST).read_text())
    change(manifest)
    (folder / library.MANIFEST).write_text(json.dumps(manifest))
    found, why = chosen()
    assert found is None and "cannot be used" in why


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "\xff", "[" * 100_000])
def test_an_invalid_manifest_is_reported(tmp_path, monkeypatch, text):
    monkeypatch.setattr(library, "FOLDER", tmp_path)
    monkeypatch.setattr(library, "CHECK", False)
    monkeypatch.setenv("POINTRAY_KERNELS", "auto")
    assert chosen() == (None, "this installation has no compiled kernels")
    (tmp_path / library.MANIFEST).write_bytes(text.encode("latin1"))
    assert chosen()[0] is None and "cannot be used" in chosen()[1]


@needs_library
def test_a_level_that_this_processor_does_not_support_is_skipped(folder):
    manifest = json.loads((folder / library.MANIFEST).read_text())
    (best, about), *_ = manifest["libraries"].items()
    manifest["libraries"] = {"x86-64-v9": about, best: about}
    (folder / library.MANIFEST).write_text(json.dumps(manifest))
    assert chosen()[1] == f"compiled for {best}"
    manifest["libraries"] = {"x86-64-v9": about}
    (folder / library.MANIFEST).write_text(json.dumps(manifest))
    assert chosen() == (None, "the compiled kernels cannot be used: this CPU does not support x86-64-v9")


@needs_library
def test_a_kernel_of_other_sources_is_not_used(folder):
    manifest = json.loads((folder / library.MANIFEST).read_text())
    assert chosen()[0]._is_current
    manifest["kernels"]["pointray.surface.tree.wide.collapse"]["key"] = "0" * 16
    manifest["sources"]["surface/tree/wide.py"] = "0" * 64
    (folder / library.MANIFEST).write_text(json.dumps(manifest))
    found, _ = chosen()
    file = PACKAGE / "surface" / "tree" / "wide.py"
    assert found.find("pointray.surface.tree.wide.collapse", file) is None
    assert found.find("pointray.surface.tree.wide.enclose", file) is not None
    assert found.find("pointray.surface.tree.wide.no_such", file) is None
    manifest["sources"] = {"removed.py": "0" * 64}
    (folder / library.MANIFEST).write_text(json.dumps(manifest))
    assert chosen()[0].find("pointray.surface.tree.wide.collapse", file) is None


@needs_library
def test_a_library_may_be_replaced_while_it_is_used(folder, monkeypatch):
    import numpy as np

    found, _ = chosen()
    for path in files_in(folder):
        path.write_bytes(b"\0" * path.stat().st_size)
    call = found.find("pointray.surface.tree.wide.enclose", PACKAGE / "surface" / "tree" / "wide.py")
    children, leaf_of = np.array([[1, 2], [-1, -1], [-1, -1]], np.int32), np.array([-1, 0, 1], np.int32)
    boxes = np.zeros((3, 6))
    call(children, leaf_of, np.array([[0, 0, 0, 1, 1, 1], [2, 2, 2, 3, 3, 3.0]]), boxes)
    assert boxes[0].tolist() == [0, 0, 0, 3, 3, 3]
    with pytest.raises(TypeError, match="pointray.surface.tree.wide.enclose: .*<f4"):
        call(children, leaf_of, boxes.astype(np.float32), boxes)
    with pytest.raises(TypeError, match="pointray.surface.tree.wide.enclose: .*arguments"):
        call(children)


@pytest.mark.parametrize("choice", [long("compiled"), "nonsense"])
def test_requested_but_missing_kernels_are_reported(tmp_path, choice):
    """The error is one line, before work starts."""
    scan = tmp_path / "a.xyz"
    scan.write_text("0 0 0\n1 0 0\n0 1 0\n" * 10)
    code = f"""
import sys
from pathlib import Path
from pointray.engine.jit import library
library.FOLDER = Path({str(tmp_path)!r})
from pointray.cli import execute
sys.exit(execute(["render", {str(scan)!r}, "-o", {str(tmp_path / "a.png")!r}]))
"""
    _, output = run(code, BAD_INPUT, POINTRAY_KERNELS=choice, POINTRAY_CHECK="")
    assert output.count("\n") == 1 and "POINTRAY_KERNELS" in output
    assert not (tmp_path / "a.png").exists()


def test_without_a_library_and_without_numba_one_line_says_what_to_install(tmp_path):
    scan = tmp_path / "a.xyz"
    scan.write_text("0 0 0\n1 0 0\n0 1 0\n" * 10)
    code = f"""
import sys
sys.modules.update(numba=None, llvmlite=None)
from pathlib import Path
from pointray.engine.jit import library
library.FOLDER = Path({str(tmp_path)!r})
from pointray.cli import execute
sys.exit(execute(["render", {str(scan)!r}, "-o", {str(tmp_path / "a.png")!r}]))
"""
    _, output = run(code, BAD_INPUT, POINTRAY_KERNELS="auto", POINTRAY_CHECK="")
    assert output == (
        "pointray: this installation has no compiled kernels, and Numba is not installed to compile them: "
        f"pip install 'pointray[jit]'; see {address_of('troubleshooting.html#missing-packages')}\n"
    )


def test_the_choice_is_printed(capsys):
    assert execute(["info", "--system", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["kernels"] == library.choice()[1] and facts["pointray"] == pointray.__version__
    assert execute(["info", "--system", "a.ply"]) == BAD_INPUT
    assert execute(["info"]) == BAD_INPUT
    assert "Missing argument" in capsys.readouterr().err
