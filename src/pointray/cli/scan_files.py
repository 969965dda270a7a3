"""The files of a scan, and checks of result files."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..base.progress import StageProgress
from ..base.warning_log import warn
from .read_options import Reading

FEW = 3  # files that a note names


def is_saved(file: Path) -> bool:
    """Whether a path has the extension of saved models, which are files, or folders if in parts."""
    from ..model.model_file import SAVED

    return file.suffix.lower() == SAVED


def is_in_parts(file: Path) -> bool:
    """Whether a path is that of a model in parts."""
    return is_saved(file) and file.is_dir()


@dataclass(frozen=True)
class ScanFiles:
    """A scan, one or several files that are read as one cloud; or a single saved model.

    Attributes
    ----------
    files : tuple of Path
    reading : Reading
    cached : bool
        Whether its model may come from the cache, and is stored there.
    """

    files: tuple[Path, ...]
    reading: Reading = Reading()
    cached: bool = False

    @property
    def name(self) -> str:
        """Name in messages."""
        return str(self.files[0]) if len(self.files) == 1 else f"{len(self.files):,} files"

    @property
    def saved(self) -> Path | None:
        """Path of the saved model; None for scans."""
        return self.files[0] if is_saved(self.files[0]) else None

    @property
    def inputs(self) -> dict[str, Any]:
        """Inputs of its points, as JSON values."""
        facts = [file.stat() for file in self.files]
        return {
            "scan": [str(file.resolve()) for file in self.files],
            "scan_bytes": [fact.st_size for fact in facts],
            "scan_written": [fact.st_mtime_ns for fact in facts],
            **self.reading.inputs,
        }

    def entry(self, **made: Any) -> Any:
        """Return the cache entry of its model, None without cache. made : parameters of the model"""
        from ..model.model_cache import entry_of

        return entry_of(self.files, {"reading": self.reading.inputs, **made}) if self.cached else None

    def check(self) -> None:
        """Raise an error if one of its files has no known format."""
        for file in self.files:
            check_scan(file, self.reading)

    def verify(self) -> None:
        """Raise an error if a file of a model in parts does not match its index."""
        from ..model.model_folder import verify_folder

        if not self.is_in_parts:
            raise ValueError("--verify requires a model in parts")
        verify_folder(self.files[0])

    @property
    def is_in_parts(self) -> bool:
        """Whether it is a model in parts."""
        return is_in_parts(self.files[0])

    def read(self, progress: StageProgress | None = None, viewpoint: tuple[float, float, float] | None = None) -> Any:
        """Return its points; not for saved models. viewpoint : scanner position, for the detection of veils"""
        import pointray as pr

        points = pr.read(self.files, progress=progress, **self.reading.arguments)
        if not self.reading.drop_strays:
            return points
        from ..cloud.outliers import without_strays

        return without_strays(points, self.name, viewpoint)


def scan_of(paths: Sequence[Path], reading: Reading, cached: bool = False) -> ScanFiles:
    """Return the scan of some paths; an error if a file is missing, or files cannot be combined."""
    files = files_of(paths)
    saved = next(filter(is_saved, files), None)
    if saved is not None and len(files) > 1:
        raise ValueError(f"{saved}: a saved model cannot be combined with other files, except in view")
    check_unread(files, reading)
    return ScanFiles(tuple(files), reading, cached)


def check_unread(files: Sequence[Path], reading: Reading) -> None:
    """Raise ValueError if options of reading are given for a saved model."""
    saved = next(filter(is_saved, files), None)
    if saved is not None and not reading.is_plain:
        option = reading.unusual[0].replace("_", "-")
        raise ValueError(f"{saved}: --{option} is for scans, not for saved models")


def files_of(paths: Sequence[Path]) -> list[Path]:
    """Return the files of some paths, for a folder the scans in it; an error if one is missing."""
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
            raise ValueError(f"{file}: is given twice" + ("" if file == other else f", also as {other}"))
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
    """Return the readable files of a folder, sorted by name; warn about the others."""
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
        raise ValueError(f"{folder}: contains no readable file; supported: {', '.join(sorted(known))}")
    if left:
        more = f" and {len(left) - FEW:,} more" if len(left) > FEW else ""
        warn(f"{folder}: skipped files that are not scans: {', '.join(left[:FEW])}{more}", stacklevel=2)
    return files


# ------------------------------------------------------------------------------------------------------- results


def check_result(output: Path, *others: str) -> None:
    """Raise an error, before any work is done, if points cannot be written to a file.

    others : extensions besides those of points that the command writes
    """
    from ..base.atomic_write import check_writable, unsupported_extension
    from ..io.known_formats import writer_of, written

    extension = output.suffix.lower()
    if extension not in (*written(), *others):
        raise unsupported_extension(output, (*written(), *others))
    if extension not in others:
        writer_of(output)  # it may require a package
    check_writable(output)


def check_not_input(files: Sequence[Path], output: Path, force: bool) -> None:
    """Raise ValueError if the result would overwrite an input."""
    if force or not output.exists():
        return
    if any(file.exists() and os.path.samefile(file, output) for file in files):
        raise ValueError(f"{output}: is an input; use --force to overwrite it")
