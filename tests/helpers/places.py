"""Folders of the project, real scans beside it, and small files that failed once."""

from __future__ import annotations

from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parents[1]
ROOT = TESTS.parent
MODELS = ROOT.parent / "shared" / "models"


def shared_model(name: str) -> Path:
    """Path of a real scan, such as 'points/stanford_bunny.ply'; skips the test if it is absent."""
    path = MODELS / name
    if not path.exists():
        pytest.skip(f"the scan {name} is not here")
    return path


def case_file(name: str) -> Path:
    """A small input that failed once; the test is skipped where it is absent."""
    path = MODELS.parent / "cases" / name
    if not path.exists():
        pytest.skip(f"{path} is not here")
    return path
