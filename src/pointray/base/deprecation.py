"""Warnings for names that have changed."""

from __future__ import annotations

from .warning_log import warn


def warn_renamed(old: str, new: str) -> None:
    """Warn the caller of a deprecated alias, which is removed after one release."""
    warn(f"{old} is deprecated: use {new}", DeprecationWarning, stacklevel=3)
