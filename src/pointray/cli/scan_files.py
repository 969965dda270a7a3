"""The files of a scan: which ones a command reads, and where its result may go."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..base.warning_log import warn
from .read_options import Reading

FEW = 3  # files that a note names


def is_saved(file: Path) -> bool:
    """Whether a file has the extension of saved models; those in parts are folders."""
    from ..model.model_file import SAVED

    return file.suffix.lower() == SAVED


def is_in_parts(file: Path) -> bool:
    """Whether a path is that of a model in parts."""
    return is_saved(file) and file.is_dir()


@dataclass(frozen=True)
class ScanFiles:
    """A scan: one file or several, which are read as one cloud; or a saved model, which is alone.

    Attributes
    ----------
    files : tuple of Path
    reading : Reading
    cached : bool
        Whether its model may come from the cache, and is kept there.
    """

    files: tuple[Path, ...]
    reading: Reading = Reading()
    cached: bool = False

    @property
    def name(self) -> str:
        """What messages call it."""
        return str(self.files[0]) if len(self.files) == 1 else f"{len(self.files):,} files"

    @property
    def saved(self) -> Path | None:
        """The saved model, if it is one."""
        return self.files[0] if is_saved(self.files[0]) else None

    @property
    def inputs(self) -> dict[str, Any]:
        """What its points depend on, as values of JSON."""
        facts = [file.stat() for file in self.files]
        return {
            "scan": [str(file.resolve()) for file in self.files],
            "scan_bytes": [fact.st_size for fact in facts],
            "scan_written": [fact.st_mtime_ns for fact in facts],
            **self.reading.inputs,
        }

    def entry(self, **made: Any) -> Any:
        """The place of its model in the cache, if it may be there; made : how the model is made"""
        from ..model.model_cache import entry_of

        return entry_of(self.files, {"reading": self.reading.inputs, **made}) if self.cached else None

    def check(self) -> None:
        """Raise an error if no format knows one of its files."""
        for file in self.files:
            check_scan(file, self.reading)

    def verify(self) -> None:
        """Raise an error if a file of a model in parts is not the one that its index describes."""
        from ..model.model_folder import verify_folder

        if not self.is_in_parts:
            raise ValueError("--verify is for models in parts")
        verify_folder(self.files[0])

    @property
    def is_in_parts(self) -> bool:
        """Whether it is a model in parts."""
        return is_in_parts(self.files[0])

    def read(
        self, progress: Callable[[float], None] | None = None, viewpoint: tuple[float, float, float] | None = None
    ) -> Any:
        """Its points, if it is no saved model. viewpoint : the scanner, from which veils are seen"""
        import pointray as pr

        points = pr.read(self.files, progress=progress, **self.reading.arguments)
        if not self.reading.drop_strays:
            return points
        from ..cloud.outliers import without_strays

        return without_strays(points, self.name, viewpoint)


def scan_of(paths: Sequence[Path], reading: Reading, cached: bool = False) -> ScanFiles:
    """The scan that a user names; an error if a file is not there, or the files do not go together."""
    files = files_of(paths)
    saved = next(filter(is_saved, files), None)
    if saved is not None and len(files) > 1:
        raise ValueError(f"{saved}: a saved model cannot be combined with other files, except in view")
    check_unread(files, reading)
    return ScanFiles(tuple(files), reading, cached)


def check_unread(files: Sequence[Path], reading: Reading) -> None:
    """ValueError if options of reading are given for a saved model, whose points have been read."""
    saved = next(filter(is_saved, files), None)
    if saved is not None and not reading.is_plain:
        option = reading.unusual[0].replace("_", "-")
        raise ValueError(f"{saved}: --{option} is for reading scans, not for a saved model")


def files_of(paths: Sequence[Path]) -> list[Path]:
    """The files that a user names, for a folder those in it that can be read; an error if one is not there."""
    from ..base.atomic_write import check_regular

    files: list[Path] = []
    for path in paths:
        if path.is_dir():
            files += [path] if is_saved(path) else _scans_in(path)
        else:
            files.append(check_regular(path))
    seen: dict[Path, Path] = {}
    for file in files:
        other = seen.setdefault(file.resolve(), file)
        if other is not file:
            raise ValueError(f"{file}: is given twice" + ("" if file == other else f", as {other} too"))
    return files


def check_scan(file: Path, reading: Reading | None = None) -> None:
    """Raise an error if a scan or a saved model cannot be opened, or a scan's header is wrong."""
    from ..base.atomic_write import check_regular
    from ..io.files import check_readable
    from ..model.model_folder import check_folder

    if is_in_parts(file):
        check_folder(file)
    elif is_saved(file):
        check_regular(file)
    else:
        check_readable(file, None if reading is None else reading.request)


def _scans_in(folder: Path) -> list[Path]:
    """The files of a folder that can be read, in the order of their names; a note tells of the others."""
    from ..io.known_formats import extensions
    from ..io.unpacking import PACKED

    known, files, left = set(extensions()), [], []
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or not path.is_file():
            continue
        inner = Path(path.stem) if path.suffix.lower() in PACKED else path
        try:
            if inner.suffix.lower() not in known:
                raise ValueError
            check_scan(path)
            files.append(path)
        except (OSError, ValueError):
            left.append(path.name)
    if not files:
        raise ValueError(f"{folder}: no file in this folder can be read; can read {', '.join(sorted(known))}")
    if left:
        more = f" and {len(left) - FEW:,} more" if len(left) > FEW else ""
        warn(f"{folder}: left aside, as no scans: {', '.join(left[:FEW])}{more}", stacklevel=2)
    return files


# ------------------------------------------------------------------------------------------------------- results


def check_result(output: Path, *others: str) -> None:
    """Raise an error, before any work is done, if points cannot be written to a file.

    others : extensions besides those of points that the command writes
    """
    from ..base.atomic_write import check_writable
    from ..io.known_formats import writer_of, written

    extension = output.suffix.lower()
    if extension not in (*written(), *others):
        known = " and ".join([", ".join(written()), *others])
        raise ValueError(f"{output}: cannot write {output.suffix or 'a file without extension'}; can write {known}")
    if extension not in others:
        writer_of(output)  # it may need a package
    check_writable(output)


def check_not_input(files: Sequence[Path], output: Path, force: bool) -> None:
    """Raise ValueError if the result would overwrite an input."""
    if force or not output.exists():
        return
    if any(file.exists() and os.path.samefile(file, output) for file in files):
        raise ValueError(f"{output}: is the input itself; --force overwrites it")
