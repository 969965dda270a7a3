"""Runs of pages: each in a process of its own; pages that have not changed are not run again."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from .inputs import SCANS, known_scans
from .pages import DOCS, ROOT, Page

RUNS = ROOT / "build" / "docs" / "runs"
LIMIT = 600  # seconds for a page


def run(page: Page, accept: bool = False) -> dict[str, Any]:
    """Run a page unless a run of the same contents is stored; return what happened (`run_page.run_page`)."""
    folder = RUNS / page.name
    key = _key(page)
    if not accept and (known := _load(folder)) and known["key"] == key and not known["problems"]:
        return known
    shutil.rmtree(folder, ignore_errors=True)
    command = [sys.executable, "-m", "docs.site.run_page", str(page.path), str(folder), *["--accept"] * accept]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT)
    result = _load(folder) or {"absent": [], "lacking": [], "seconds": 0.0}
    if done.returncode:
        result["problems"] = [f"{page.name}: {(done.stdout + done.stderr)[-2000:]}"]
    result["key"] = key if not accept else _key(page)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "result.json").write_text(json.dumps(result))
    return result


def _load(folder: Path) -> dict[str, Any] | None:
    try:
        return dict(json.loads((folder / "result.json").read_text()))
    except (OSError, ValueError):
        return None


def _key(page: Page) -> str:
    """Return a hash of everything that a run reads: the page, its pictures and scans, and the package."""
    known = known_scans()
    scans = [SCANS / str(known[name].get("path", "-")) for name in page.scans.values() if name in known]
    sources = [*sorted((ROOT / "src").rglob("*.py")), *sorted((ROOT / "examples").rglob("*.*")), DOCS / "scans.toml"]
    digest = hashlib.sha256()
    for path in [page.path, *page.pictures, *sorted((DOCS / "site").glob("*.py")), *sources]:
        digest.update(path.read_bytes() if path.is_file() else b"-")
    for path in scans:
        digest.update(f"{path.stat().st_size if path.exists() else None}".encode())
    return digest.hexdigest()
