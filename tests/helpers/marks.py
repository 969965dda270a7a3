"""Marks of single cases of a test."""

from __future__ import annotations

import pytest


def long(*values: object) -> object:
    """Mark a case of a test that takes more than half a second: `make long` runs it."""
    return pytest.param(*values, marks=pytest.mark.long)


def scan(*values: object) -> object:
    """Mark a case of a test that reads a real scan."""
    return pytest.param(*values, marks=pytest.mark.scans)


def long_scan(*values: object) -> object:
    """Mark a case of a test that reads a real scan and takes more than half a second."""
    return pytest.param(*values, marks=[pytest.mark.scans, pytest.mark.long])
