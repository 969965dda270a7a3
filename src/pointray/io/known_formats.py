"""Which formats there are, which one a file has, and what each keeps."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path

from ..base.arguments import check_path
from ..base.extras import require
from .formats._source import HEAD, NO, Format, Writer
from .unpacking import PACKED

# What to do with files of other programs, by their extensions.
_SPLATS, _SCANNER = "convert it to .ply, with SuperSplat for instance", "export it as E57 with the scanner's program"
_MESH = "export it as .glb or .obj, with Blender for instance"
HINTS = {
    **dict.fromkeys((".sog", ".lcc"), _SPLATS),
    **dict.fromkeys((".rcp", ".rcs", ".fls", ".lsproj", ".zfs", ".imp", ".rdbx", ".rxp"), _SCANNER),
    **dict.fromkeys((".fbx", ".blend", ".dae", ".3mf", ".usd", ".usdz", ".max"), _MESH),
    **dict.fromkeys((".zip", ".7z", ".rar", ".tar", ".tgz"), "unpack it"),
}


@cache
def _formats() -> dict[str, Format]:
    """All formats, by the names of their files: those in `formats/` and its folders that do not begin with _."""
    root = Path(__file__).parent
    files = sorted(path.relative_to(root) for path in (root / "formats").rglob("[!_]*.py"))
    names = [".".join((__package__, *file.with_suffix("").parts)) for file in files]
    return {name.rsplit(".", 1)[1]: import_module(name).FORMAT for name in names}


def format_of(path: Path, named: Path | None = None) -> Format:
    """The format of a file. ValueError if none knows it.

    named : the file as its user calls it, if it is read from another place
    """
    file = named or path
    with path.open("rb") as stream:
        head = stream.read(HEAD)
    if not head:
        raise ValueError(f"{file}: is empty")
    inner = Path(file.stem) if file.suffix.lower() in PACKED else file
    certain = {name: format.recognise(head, inner) for name, format in _formats().items()}
    best = max(certain, key=lambda name: certain[name])
    if certain[best] == NO:
        meant = [x for x in _formats().values() if inner.suffix.lower() in x.extensions]
        # Splats are PLY files too, of a kind that is only read.
        names = [x.name for x in meant if x.write is not None] or [x.name for x in meant]
        what = (
            f"is no {' or '.join(names)} file" if meant else f"cannot read {inner.suffix or 'a file without extension'}"
        )
        if not meant and inner.suffix.lower() in HINTS:
            raise ValueError(f"{file}: {what}: {HINTS[inner.suffix.lower()]}")
        raise ValueError(f"{file}: {what}: it begins with {head[:12]!r}; can read {', '.join(extensions())}")
    found = _formats()[best]
    if found.extra is not None:
        require(found.extra[0], found.extra[1], str(file))
    return found


def extensions() -> list[str]:
    """The extensions of files that can be read."""
    return sorted({extension for format in _formats().values() for extension in format.extensions})


def written() -> list[str]:
    """The extensions of files that can be written."""
    return sorted({x for format in _formats().values() if format.write is not None for x in format.extensions})


@dataclass(frozen=True)
class FormatFacts:
    """What is known of a format.

    Attributes
    ----------
    name : str
    extensions : tuple of str
    writes : bool
        Whether it can be written too.
    extra : str or None
        The extra of pointray that it needs: pip install 'pointray[extra]'.
    keeps : dict of str to str
        What is kept of a file, in words.
    """

    name: str
    extensions: tuple[str, ...]
    writes: bool
    extra: str | None
    keeps: Mapping[str, str]


def formats() -> list[FormatFacts]:
    """What can be read and written, and what each format keeps."""
    return [
        FormatFacts(x.name, x.extensions, x.write is not None, x.extra[1] if x.extra else None, dict(x.keeps))
        for x in sorted(_formats().values(), key=lambda x: x.name.lower())
    ]


def writer_of(path: str | os.PathLike[str]) -> Writer:
    """The writer of the format that a file's extension names; ValueError if there is none."""
    file = check_path(path)
    for format in _formats().values():
        if format.write is not None and file.suffix.lower() in format.extensions:
            if format.extra is not None:
                require(format.extra[0], format.extra[1], str(file))
            return format.write
    known = ", ".join(written())
    raise ValueError(f"{file}: cannot write {file.suffix or 'a file without extension'}; can write {known}")
