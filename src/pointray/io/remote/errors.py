"""Errors of remote files, in words for users. The messages name the URL without passwords and signatures."""

from __future__ import annotations

import errno
import re
from typing import Any

from . import transport
from .addresses import shown_url

WEB_PAGE = re.compile(
    rb"(?:\xef\xbb\xbf)?\s*(?:<!--.*?-->\s*|<\?xml[^>]*\?>\s*)*<(?:!doctype\s+html|html)\b", re.I | re.S
)
URL = re.compile(r"[a-zA-Z][a-zA-Z0-9+.-]+:/\S+")


class WebPageError(OSError, ValueError):
    """Error for a web page in place of a scan. Also a ValueError, like those of other files that are no scans."""


class NoAnswerError(TimeoutError):
    """Error for a server that does not answer in time. Futures replace a plain TimeoutError, without its file name."""


def check_no_web_page(head: bytes, shown: str) -> None:
    """Raise WebPageError if a file begins like an HTML page. head : its first bytes"""
    if WEB_PAGE.match(head):
        raise WebPageError(errno.EINVAL, "is a web page, not a scan: use the address of the file itself", shown)


def status_error(status: int, shown: str) -> OSError:
    """Return the error for a status of HTTP that is not a success."""
    code = f"(HTTP {status})"
    if status in (404, 410):
        return FileNotFoundError(errno.ENOENT, f"not found {code}: check the address", shown)
    if status in (401, 403, 407):
        return PermissionError(errno.EACCES, f"access denied {code}: check the address, or whether to sign in", shown)
    if status == 429:
        return OSError(errno.EBUSY, f"the server refuses further requests for now {code}: try again later", shown)
    if status >= 500:
        return OSError(errno.EIO, f"the server reports an error {code}: try again later", shown)
    return OSError(errno.EIO, f"unexpected answer of the server {code}: check the address", shown)


def changed_error(shown: str) -> OSError:
    """Return the error for a file that was modified on the server between two requests."""
    return OSError(errno.ESTALE, "was modified while it was read; read it again", shown)


def no_ranges_error(shown: str) -> OSError:
    """Return the error for a server that sent parts of the file at first, but not later."""
    return OSError(
        errno.EIO, "the server stopped sending parts of the file: download the file and open the copy", shown
    )


def timeout_error(shown: str, seconds: float) -> TimeoutError:
    """Return the error for a server that does not answer, or sends nothing more, within this time."""
    return NoAnswerError(
        errno.ETIMEDOUT, f"no answer from the server within {seconds:g} seconds: try again later", shown
    )


def lost_error(shown: str, why: str = "") -> ConnectionError:
    """Return the error for a connection that ended before all bytes were there. why : further words"""
    return ConnectionError(errno.ECONNRESET, f"connection lost{why}: try again", shown)


def unreachable_error(shown: str) -> ConnectionError:
    """Return the error for a server that no connection can be made to."""
    return ConnectionError(errno.ECONNREFUSED, "cannot connect to the server: check the address and the network", shown)


def store_error(error: Any, url: str, shown: str) -> Exception:
    """Return the OSError, ImportError or ValueError for an exception of fsspec or of the package of a store.

    url : the address with its secrets, which are removed from the message
    """
    from ...base.extras import MissingPackageError

    name, text = type(error).__name__, _without_secrets(str(error), url, shown)
    if isinstance(error, ImportError):
        known = url.partition(":")[0].lower() in ("http", "https", "s3", "gs", "gcs")
        advice = f" ({text}): pip install 'pointray[remote]'" if known else f": {text}"
        return MissingPackageError(f"{shown} needs further packages{advice}")
    if isinstance(error, FileNotFoundError):
        return FileNotFoundError(errno.ENOENT, "not found: check the address", shown)
    if isinstance(error, PermissionError) or "Credential" in name:
        advice = "check your credentials; for a public bucket set FSSPEC_S3='{\"anon\": true}'"
        return PermissionError(
            errno.EACCES, f"access denied: {advice}" if url.startswith("s3") else "access denied", shown
        )
    if isinstance(error, IsADirectoryError):
        return IsADirectoryError(errno.EISDIR, "is a folder: give the address of a file", shown)
    if isinstance(error, TimeoutError) or "Timeout" in name:
        return timeout_error(shown, transport.READ)
    if isinstance(error, ConnectionError) or "Connect" in name or "Endpoint" in name:
        return unreachable_error(shown)
    if isinstance(error, ValueError) and "Protocol not known" in str(error):
        return ValueError(f"{shown}: unsupported kind of address; supported: http, https, s3, gs and others of fsspec")
    if isinstance(error, OSError) and error.errno is not None:
        return OSError(error.errno, _without_secrets(str(error.strerror or text), url, shown), shown)
    return OSError(errno.EIO, f"cannot be read: {name}: {text}", shown)


def _without_secrets(text: str, url: str, shown: str) -> str:
    """Return one line of at most 200 characters, whose URLs are shown without secrets. url, shown : see above"""
    text = URL.sub(lambda found: shown_url(found[0]), " ".join(text.replace(url, shown).split()))
    return re.sub(r"\?\S+", "?...", text)[:200]
