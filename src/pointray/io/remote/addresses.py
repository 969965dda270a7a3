"""URLs: their detection, and their names for messages, without passwords and signatures."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit
from urllib.request import url2pathname

SCHEME = re.compile(r"([a-zA-Z][a-zA-Z0-9+.-]+)://")  # at least two letters: C:// is a drive
COLLAPSED = re.compile(r"(https?|s3a?|gs|gcs|s?ftp|ssh|abfss?|az):[/\\](?![/\\])", re.I)  # a URL turned into a path
BEGINNING = re.compile(r"(?:[a-zA-Z][a-zA-Z0-9+.-]*:)?[/\\]*")  # scheme and slashes; a path object has one slash
WEB = re.compile(r"https?://", re.I)
HOST = re.compile(r"([^/?#]*)(.*)", re.S)  # with user name and password, and what follows
LOCAL = ("file", "local")
LONGEST = 120  # bytes of a file name in UTF-8; most file systems allow 255


def is_url(value: Any) -> bool:
    """Return whether a value is a string with the URL of a remote file; file:// is local."""
    found = SCHEME.match(value) if isinstance(value, str) else None
    return found is not None and found[1].lower() not in LOCAL


def local_path_of(value: str | os.PathLike[str]) -> Path:
    """Return a string or path object as a Path, also if it is a file:// URL; raise ValueError if it is a broken URL."""
    if isinstance(value, str) and (found := SCHEME.match(value)) and found[1].lower() in LOCAL:
        return Path(url2pathname(urlsplit(value).path))
    path = Path(value)
    if COLLAPSED.match(str(path)) and not path.exists():
        raise ValueError(f"{shown_url(str(path))}: a URL must be given as a str, not as a path object")
    return path


def shown_url(url: str) -> str:
    """Return a URL for messages: without user name, password, query and fragment, which may contain secrets.

    If an @ follows later than the host, a colon before may begin a password that contains / ? or #, such as
    https://me:pass/word@host/a.ply: nothing but the scheme is shown.
    """
    start = BEGINNING.match(url)[0]  # type: ignore[index]  # it matches any text
    host, later = HOST.match(url, len(start)).groups()  # type: ignore[union-attr]
    if ":" in host and "@" in later:
        return f"{start}..."
    path, query, _ = later.partition("#")[0].partition("?")
    return f"{start}{host.rpartition('@')[2]}{path}{'?...' if query else ''}"


def check_url(url: str) -> str:
    """Return a URL; raise ValueError if it is invalid, lacks its host (http, https), or chains several file systems."""
    shown = shown_url(url)
    if "::" in url.partition("?")[0] and not WEB.match(url):  # in http://[::1]/ it is part of the host
        raise ValueError(f"{shown}: chained URLs are unsupported; download the file first")
    if any(ord(letter) < 33 or ord(letter) == 127 for letter in url):
        raise ValueError(f"{shown}: invalid URL: it contains spaces or control characters; write %20 for a space")
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname, parts.port
        if WEB.match(url):
            (host or "").encode("idna")
    except ValueError:  # also of the encoding, for http://a..b/
        raise ValueError(f"{shown}: invalid URL") from None
    if parts.scheme in ("http", "https") and not host:
        raise ValueError(f"{shown}: invalid URL: the host is missing")
    return url


def file_name_of(url: str) -> str:
    """Return the file name at the end of a URL, fit for any file system; "download" if there is none."""
    path = url.partition("://")[2].partition("?")[0].partition("#")[0]
    return clean_name(unquote(path.rpartition("/")[2]) if "/" in path else "")


def clean_name(name: str) -> str:
    """Return a file name without characters that a file system may refuse, and not too long; keep its extension."""
    name = re.sub(r'[\x00-\x1f\x7f/\\:*?"<>|]', "_", name)
    return name.encode(errors="ignore")[-LONGEST:].decode(errors="ignore").lstrip(". ") or "download"
