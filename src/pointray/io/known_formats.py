"""Registry of the formats: detection of a file's format, extensions, writers."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path

from ..base.arguments import check_path
from ..base.atomic_write import unsupported_extension
from ..base.extras import require
from .formats._source import HEAD, NO, Format, Request, Writer
from .plugins import plugin_formats
from .remote.remote_file import Location
from .unpacking import PACKED

# Advice for files of other programs, by extension.
_SPLATS, _SCANNER = "convert it to .ply, for example with SuperSplat", "export it as E57 from the scanner software"
_MESH = "export it as .glb or .obj, for example with Blender"
HINTS = {
    **dict.fromkeys((".sog", ".lcc"), _SPLATS),
    **dict.fromkeys((".rcp", ".rcs", ".fls", ".lsproj", ".zfs", ".imp", ".rdbx", ".rxp"), _SCANNER),
    **dict.fromkeys((".fbx", ".blend", ".dae", ".3mf", ".usd", ".usdz", ".max"), _MESH),
    **dict.fromkeys((".zip", ".7z", ".rar", ".tar", ".tgz"), "unpack it"),
}


def format_files() -> list[Path]:
    """Return the source files of the modules that define formats: all in `formats/` whose names do not begin with _."""
    return sorted((Path(__file__).parent / "formats").rglob("[!_]*.py"))


@cache
def _formats() -> dict[str, Format]:
    """Import the modules of all formats on the first call; return the formats by module name, for example "ply".

    Formats that other packages read follow, by extension.
    """
    root = Path(__file__).parent
    names = [".".join((__package__, *file.relative_to(root).with_suffix("").parts)) for file in format_files()]
    return {name.rsplit(".", 1)[1]: import_module(name).FORMAT for name in names} | plugin_formats()


def format_of(path: Path, named: Location | None = None) -> Format:
    """Detect the format of a file from its first bytes and its name; raise ValueError if it is unknown.

    named : the file given by the user, if `path` is a copy of it, downloaded or decompressed
    """
    with path.open("rb") as stream:
        return format_by(stream.read(HEAD), named or path)


def format_by(head: bytes, file: Location) -> Format:
    """Return the format of a file with these first bytes and this name; raise ValueError if it is unknown.

    head : the first `HEAD` bytes, decompressed
    """
    if not head:
        raise ValueError(f"{file}: is empty")
    inner = file if isinstance(file, Path) else Path(file.name)
    inner = Path(inner.stem) if inner.suffix.lower() in PACKED else inner
    certain = {name: format.recognise(head, inner) for name, format in _formats().items()}
    best = max(certain, key=lambda name: certain[name])
    if certain[best] == NO:
        meant = [x for x in _formats().values() if inner.suffix.lower() in x.extensions]
        # Splats are stored in PLY files too; the first format is the one that `write` selects.
        names = [x.name for x in meant if x.write is not None][:1] or [x.name for x in meant]
        what = (
            f"invalid {' or '.join(names)} file"
            if meant
            else f"unsupported file type {inner.suffix or '(no extension)'}"
        )
        if not meant and inner.suffix.lower() in HINTS:
            raise ValueError(f"{file}: {what}: {HINTS[inner.suffix.lower()]}")
        raise ValueError(f"{file}: {what}: begins with {head[:12]!r}; supported formats: {', '.join(extensions())}")
    found = _formats()[best]
    if found.extra is not None:
        require(found.extra[0], found.extra[1], str(file))
    return found


def format_in_pieces(head: bytes, request: Request) -> Format | None:
    """Return the format of a remote file if it needs only parts of the file for a request; None otherwise.

    head : first bytes of the file
    """
    return next((x for x in _formats().values() if x.in_pieces is not None and x.in_pieces(head, request)), None)


def extensions() -> list[str]:
    """Return the extensions of files that can be read, with the dot, sorted."""
    return sorted({extension for format in _formats().values() for extension in format.extensions})


def written() -> list[str]:
    """Return the extensions of files that can be written, with the dot, sorted."""
    return sorted({extension for format in _formats().values() for extension in format.targets})


@dataclass(frozen=True)
class FormatFacts:
    """Description of a file format, returned by `formats`.

    Attributes
    ----------
    name : str
        Name for users, for example "PLY".
    extensions : tuple of str
        Usual extensions of its files, with the dot.
    writes : bool
        Whether it can be written as well as read.
    extra : str or None
        The optional dependency group of pointray it needs: pip install 'pointray[extra]'.
    keeps : dict of str to str
        What is read from a file, in words: "positions", "normals", "colors", "attributes", "survey" (the georeference)
        and "note".

    Examples
    --------
    >>> next(known for known in pr.formats() if known.name == "PLY").writes
    True
    """

    name: str
    extensions: tuple[str, ...]
    writes: bool
    extra: str | None
    keeps: Mapping[str, str]


def formats() -> list[FormatFacts]:
    """List the supported formats, what each stores, and whether it can be written.

    Returns
    -------
    list of FormatFacts
        Each with `name`, `extensions`, `writes`, `extra` (the optional dependency group that it needs, or None) and
        `keeps` (what is read, in words).

    Examples
    --------
    >>> [extension for known in pr.formats() if known.name == "PLY" for extension in known.extensions]
    ['.ply']
    """
    return [
        FormatFacts(x.name, x.extensions, x.write is not None, x.extra[1] if x.extra else None, dict(x.keeps))
        for x in sorted(_formats().values(), key=lambda x: x.name.lower())
    ]


def writer_of(path: str | os.PathLike[str], compressed: bool = False) -> Writer:
    """Return the function that writes files with the extension of `path`; ValueError if there is none.

    It takes an output stream, the points and a progress callback, and returns what the format cannot store, in words.
    For .ply it is that of the format PLY, whose module comes before those of Gaussian splats.

    compressed : whether the format's compressed variant is written
    """
    file = check_path(path)
    name = file.name.lower() if file.suffix else ""
    matching = [(len(x), format) for format in _formats().values() for x in format.targets if name.endswith(x)]
    if not matching:
        raise unsupported_extension(file, written())
    _, format = max(matching, key=lambda match: match[0])  # .copc.laz before .laz
    writer = format.write_compressed if compressed else format.write
    if writer is None:
        known = [x for one in _formats().values() if one.write_compressed is not None for x in one.targets]
        raise ValueError(f"{file}: compressed applies to {', '.join(known)} only")
    if format.extra is not None:
        require(format.extra[0], format.extra[1], str(file))
    return writer
