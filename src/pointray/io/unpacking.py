"""Decompression of .gz and .zst files into a temporary file, because readers need to seek."""

from __future__ import annotations

import gzip
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from ..base.extras import require
from ..base.warning_log import warn
from .remote.remote_file import Location

PACKED = {".gz": b"\x1f\x8b", ".zst": b"\x28\xb5\x2f\xfd"}  # usual extension -> first bytes
BLOCK = 1 << 20  # bytes
SPARE = 1 << 28  # bytes of the disk to leave free


def packing_of(file: Path) -> str | None:
    """Return the compression of a file, ".gz" or ".zst", by its first bytes; None if it is not compressed."""
    with file.open("rb") as stream:
        return packing_by(stream.read(4))


def packing_by(head: bytes) -> str | None:
    """Return the compression of a file, ".gz" or ".zst"; None if it is not compressed. head : its first bytes"""
    return next((name for name, magic in PACKED.items() if head.startswith(magic)), None)


@contextmanager
def unpacked(file: Path, strict: bool = True, named: Location | None = None) -> Iterator[Path]:
    """Decompress a file into a temporary one; yield its path, which exists while the context lasts.

    Raise ValueError if the file is damaged or does not fit on the disk.

    strict : refuse a truncated file; otherwise warn
    named : the file given by the user, if `file` is a copy of it
    """
    packing, named = packing_of(file), named or file
    with tempfile.TemporaryDirectory(prefix="pointray-") as folder:
        path = Path(folder) / (named.stem if named.suffix.lower() in PACKED else named.name)
        try:
            with file.open("rb") as raw, _reader(raw, packing, named) as stream, path.open("wb") as out:
                while block := _next(stream, named, out.tell(), strict):
                    if shutil.disk_usage(folder).free < len(block) + SPARE:
                        raise ValueError(f"{named}: cannot be decompressed: the disk of {folder} is full")
                    out.write(block)
        except (EOFError, gzip.BadGzipFile) as error:
            raise ValueError(f"{named}: is damaged or cut off: {error}") from error
        except Exception as error:
            if isinstance(error, OSError | ValueError):
                raise
            raise ValueError(f"{named}: is damaged or cut off: {error}") from error  # zlib.error, ZstdError
        yield path


def _next(stream: Any, named: Location, done: int, strict: bool) -> bytes:
    """Return the next decompressed bytes of a stream; b"" at the end or, with a warning, where the file is cut off.

    named : the file, for the warning; done : bytes decompressed so far
    strict : raise EOFError where the file is cut off
    """
    try:
        return bytes(stream.read1(BLOCK))
    except EOFError:
        if strict or not done:
            raise
        warn(f"{named}: is cut off: only {done:,} bytes could be decompressed", stacklevel=2)
        return b""


def _reader(raw: IO[bytes], packing: str | None, named: Location) -> Any:
    if packing == ".gz":
        return gzip.GzipFile(fileobj=raw)
    module = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
    return require(module, "files", str(named)).ZstdFile(raw)
