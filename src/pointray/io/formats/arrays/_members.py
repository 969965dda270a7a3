"""Arrays of an NPZ file, a zip archive, checked before they are read; and its data about the whole cloud."""

from __future__ import annotations

import errno
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from ....cloud.georeference import Georeference
from ._array import Header, blocks_of, read_header

SUFFIX = ".npy"
DEFLATE_RATIO = 1032  # maximum compression ratio of deflate
LONGEST_TEXT = 1 << 20
MOST_STATIONS = 1 << 20
DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError),
    *(struct.error, OverflowError, KeyError, UnicodeError),
)


class Member(NamedTuple):
    """An array of an NPZ archive: its entry in the zip directory, and the header of the array."""

    info: zipfile.ZipInfo
    header: Header

    def open(self, archive: zipfile.ZipFile) -> IO[bytes]:
        """Open the array in the archive as a stream that begins at its values."""
        stream = archive.open(self.info)
        stream.read(self.header.size)
        return stream


@contextmanager
def opened(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open a zip archive; convert errors, also those raised while it is read, to ValueError."""
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except DAMAGE as error:
        raise ValueError(f"is damaged or cut off: {str(error) or 'an array ends too early'}") from error
    except OSError as error:
        if error.errno != errno.EINVAL:  # seek before the beginning of the file
            raise
        raise ValueError("is damaged or cut off: invalid table of contents") from error


def members_of(archive: zipfile.ZipFile, size: int) -> dict[str, Member]:
    """Return the arrays of an archive of `size` bytes by name; raise ValueError if one announces too many values."""
    infos = [info for info in archive.infolist() if info.filename.endswith(SUFFIX)]
    if sum(info.compress_size for info in infos) > size:
        raise ValueError("is damaged: its arrays are larger than the file")
    members: dict[str, Member] = {}
    for info in infos:
        name = info.filename.removesuffix(SUFFIX)
        if name in members:
            raise ValueError(f"is damaged: duplicate array {name!r}")
        try:
            members[name] = _member(archive, info)
        except ValueError as error:
            raise ValueError(f"array {name!r}: {error}") from error
    return members


def _member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Member:
    if info.flag_bits & 1:
        raise ValueError("is encrypted")
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError("has an unsupported compression, which NumPy does not write")
    most = info.compress_size * (DEFLATE_RATIO if info.compress_type == zipfile.ZIP_DEFLATED else 1)
    if info.file_size > most:
        raise ValueError(f"{info.file_size:,} bytes expected, but at most {most:,} can be stored")
    with archive.open(info) as stream:
        header = read_header(stream)
    if not header.dtype.hasobject and header.size + header.nbytes != info.file_size:
        raise ValueError(f"{header.nbytes:,} bytes expected, {info.file_size - header.size:,} found")
    return Member(info, header)


def pop_metadata(archive: zipfile.ZipFile, members: dict[str, Member]) -> dict[str, Any]:
    """Return what an archive states about the whole cloud, and remove it from `members`.

    This is "origin", (3,), and the fields "crs", "unit", "scale", "offset" and "stations" of a `Georeference`.

    members : arrays of the archive by name
    """
    facts: dict[str, Any] = {}
    for name in ("crs", "unit"):
        if name in members and members[name].header.shape in ((), (1,)) and members[name].header.dtype.kind in "US":
            facts[name] = _text(archive, members.pop(name), name)
    for name in ("origin", "scale", "offset"):
        if name in members and members[name].header.shape == (3,) and members[name].header.dtype.kind in "iuf":
            facts[name] = _numbers(archive, members.pop(name), name)
    if "stations" in members:
        header = members["stations"].header
        if header.width == 3 and header.rows <= MOST_STATIONS and header.dtype.kind in "iuf":
            facts["stations"] = _numbers(archive, members.pop("stations"), "stations")
    return facts


def georeference_of(facts: Mapping[str, Any]) -> Georeference:
    """Return the georeference that an archive states. A scale without an offset is ignored.

    facts : values of "crs", "unit", "scale", "offset" and "stations"; any may be missing
    """
    stated = {name: facts.get(name) or None for name in ("crs", "unit")}
    grid = (facts.get("scale"), facts.get("offset"))
    if grid[0] is None or grid[1] is None or min(grid[0]) <= 0:
        grid = (None, None)
    return Georeference(stated["crs"], stated["unit"], *grid, tuple(facts.get("stations", ())))


def _text(archive: zipfile.ZipFile, member: Member, name: str) -> str:
    if member.header.nbytes > LONGEST_TEXT:
        raise ValueError(f"{name} is a text of {member.header.nbytes:,} bytes, which is too long")
    with member.open(archive) as stream:
        data = stream.read()
    dtype = member.header.dtype
    encoding = "utf-8" if dtype.kind == "S" else "utf-32-be" if dtype.byteorder == ">" else "utf-32-le"
    try:
        return data.decode(encoding).rstrip("\0")
    except UnicodeDecodeError as error:
        raise ValueError(f"{name} is not a valid text: {error}") from error


def _numbers(archive: zipfile.ZipFile, member: Member, name: str) -> Any:
    """Read an array as a tuple of floats, or of tuples of floats; raise ValueError if a number is not finite.

    name : of the array, for the message
    """
    with member.open(archive) as stream:
        blocks = [block.astype(np.float64) for block in blocks_of(stream, member.header, MOST_STATIONS)]
    values = np.concatenate(blocks) if blocks else np.empty((0, 3))
    if not np.isfinite(values).all():
        raise ValueError(f"{name} must be finite, not {values.reshape(-1)[:6].tolist()}")
    return tuple(map(tuple, values.tolist())) if values.ndim > 1 else tuple(values.tolist())
