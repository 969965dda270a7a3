"""Addresses of the manual, and the page that explains an error."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeVar

MANUAL = "https://pointray.readthedocs.io"
REPORT = "troubleshooting.html#report-a-bug"
# The page for messages that match a pattern; the first match counts.
PAGES = {
    r": pip install ": "troubleshooting.html#missing-packages",
    r"not enough memory|of memory are needed": "troubleshooting.html#out-of-memory",
    r"most normals point inward": "troubleshooting.html#normals-point-inward",
    r"unsupported file type|begins with b['\"]|--columns": "troubleshooting.html#unknown-format",
    r"cut off|is damaged": "troubleshooting.html#truncated-files",
    r"contains no|: is empty|none of the \d+ files|left no points": "troubleshooting.html#no-points",
    r"\(HTTP \d+\)|the server |is a web page": "remote.html",
    r"\.toml:\d+: (?!.*No such file)|not valid TOML": "scenes.html",
}

Failure = TypeVar("Failure", bound=Exception)


def address_of(page: str) -> str:
    """Return the address of a page of the manual, in its default version. page : such as "scenes.html" """
    return f"{MANUAL}/page/{page}"


def page_about(message: str) -> str | None:
    """Return the address of the page that explains an error or a warning with this message; None if there is none."""
    page = next((page for pattern, page in PAGES.items() if re.search(pattern, message)), None)
    return page and address_of(page)


def with_note(error: Failure) -> Failure:
    """Return an error after adding a note that names the manual's page about it, if there is one."""
    page = page_about(str(error))
    note = f"See {page}"
    if page is not None and note not in getattr(error, "__notes__", ()):
        error.add_note(note)
    return error


@contextmanager
def noted() -> Iterator[None]:
    """Add a note with the manual's page to a ValueError or OSError raised in this context."""
    try:
        yield
    except (ValueError, OSError) as error:
        with_note(error)
        raise
