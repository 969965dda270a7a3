"""The scans that pages read, listed in `docs/scans.toml`, and stand-ins for those that are absent.

Real scans have licences of their own and are not part of the project. A scan with `path` lies in the folder of the
environment variable POINTRAY_SCANS; where it is absent a page runs with a small statue, and what its blocks produce
from that is not compared.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np

from .pages import DOCS, ROOT, Page

SCANS = Path(os.environ.get("POINTRAY_SCANS") or ROOT.parent / "shared" / "models")
POINTS = 20_000  # of a stand-in


def known_scans() -> dict[str, dict[str, object]]:
    """Return the scans of `docs/scans.toml` by name."""
    return tomllib.loads((DOCS / "scans.toml").read_text())


def place_scans(page: Page, folder: Path) -> set[str]:
    """Put the scans of a page, examples and documents into a folder; return the files that are stand-ins."""
    for name in ("examples", "docs"):
        (folder / name).symlink_to(ROOT / name)
    known, absent = known_scans(), set()
    for file, name in page.scans.items():
        if name not in known:
            raise ValueError(f"{page.name}: scan {name!r} is not in docs/scans.toml")
        if not _place(known[name], folder / file):
            absent.add(file)
    return absent


def _place(scan: dict[str, object], path: Path) -> bool:
    """Put a scan into a file, or a stand-in; return whether it is the real one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if "statue" in scan:
        _write_statue(path, int(str(scan["statue"])))
        return True
    if "program" in scan:
        made = subprocess.run([sys.executable, ROOT / str(scan["program"]), path.name], cwd=path.parent)
        if made.returncode == 0 and path.exists():
            return True
    source = DOCS / str(scan["file"]) if "file" in scan else SCANS / str(scan.get("path", "-"))
    if source.is_file() and source.suffix == path.suffix:
        shutil.copy(source, path)
        return True
    _write_statue(path, POINTS)
    return False


def _write_statue(path: Path, points: int) -> None:
    """Write the procedural statue, with the attributes of an airborne scan."""
    import pointray as pr

    statue = pr.procedural("statue", points)
    height = np.asarray(statue)[:, 2]
    classes = np.where(height < 0.3, 2, np.where(height < 1, 5, 6)).astype(np.uint8)
    attributes = {"classification": classes, "intensity": (1000 * np.abs(statue.normals[:, 0])).astype(np.uint16)}
    pr.write(path, pr.Points(statue.positions, statue.normals, statue.colors, attributes))
