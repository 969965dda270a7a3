"""The files that `prepare` reads, and checks of those that it writes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..base.warning_log import warn

if TYPE_CHECKING:
    from ..io.formats._source import Request
    from ..io.inputs import Paths
    from ..io.remote.remote_file import Location

# Other modules are imported when they are needed: the command line's help must appear at once.

FEW = 3  # files that a note names


def is_saved(file: Location) -> bool:
    """Return whether a path has the extension of saved models (.pointray): files, or folders of models in parts."""
    from .model_file import SAVED

    return file.suffix.lower() == SAVED


def is_in_parts(file: Location) -> bool:
    """Return whether a path is an existing folder with the extension of saved models (.pointray): a model in parts."""
    return is_saved(file) and file.is_dir()


def files_of(paths: Paths) -> list[Location]:
    """Return the files of some paths or URLs, for a folder the scans in it; folders of models in parts stay one path.

    Raises
    ------
    OSError, ValueError
        If a file is missing, is no regular file or is given twice, or if there is no file at all.
    """
    from ..io.inputs import check_exists, locations_of

    files: list[Location] = []
    for path in locations_of(paths, "paths"):
        if isinstance(path, Path) and path.is_dir():
            files += [path] if is_saved(path) else _scans_in(path)
        else:
            files.append(check_exists(path))
    if not files:
        raise ValueError("paths must name at least one file")
    seen: dict[Location, Location] = {}
    for file in files:
        other = seen.setdefault(file.resolve(), file)
        if other is not file:
            raise ValueError(f"{file}: is given twice" + ("" if file == other else f", also as {other}"))
    return files


def check_scan(file: Location, request: Request | None = None) -> None:
    """Raise an error if a scan or a saved model cannot be opened, or a scan's header is wrong.

    request : options of reading, such as the columns of a text file; they apply to scans only
    """
    from ..io.files import check_readable
    from ..io.inputs import check_exists
    from .model_folder import check_folder

    if isinstance(file, Path) and is_in_parts(file):
        check_folder(file)
    elif is_saved(file):
        check_exists(file)
    else:
        check_readable(file, request)


def _scans_in(folder: Path) -> list[Path]:
    """Return the readable scans directly in a folder, sorted by name; warn about files that are not scans."""
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


def check_result(output: Path, *others: str) -> None:
    """Raise an error, before any work is done, if points cannot be written to the file `output`.

    others : further extensions that the command can write, such as ".pointray" for models
    """
    from ..base.atomic_write import check_writable, unsupported_extension
    from ..io.known_formats import writer_of, written

    extension = output.suffix.lower()
    if extension not in (*written(), *others):
        raise unsupported_extension(output, (*written(), *others))
    if extension not in others:
        writer_of(output)  # it may require a package
    check_writable(output)


def check_not_input(files: Sequence[Location], output: Path, force: bool, option: str = "--force") -> None:
    """Raise a ValueError if the result `output` would overwrite one of the input files and `force` is not set.

    option : name of the option that allows it, for the message
    """
    if force or not output.exists():
        return
    if any(isinstance(file, Path) and file.exists() and os.path.samefile(file, output) for file in files):
        raise ValueError(f"{output}: is an input; use {option} to overwrite it")
