"""The files of a scan, and how they are read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..base.progress import StageProgress
from ..model.scan_inputs import check_scan, files_of, is_in_parts, is_saved
from .read_options import Reading

if TYPE_CHECKING:
    from ..io.remote.remote_file import Location


@dataclass(frozen=True)
class ScanFiles:
    """The files of a scan, which are read as one cloud, and how they are read; or a single saved model.

    Attributes
    ----------
    files : tuple of Path or RemoteFile
    reading : Reading
        Options of reading, such as columns and bounds.
    cached : bool
        Whether the scan's model may come from the cache on disk, and is stored there.
    """

    files: tuple[Location, ...]
    reading: Reading = Reading()
    cached: bool = False

    @property
    def name(self) -> str:
        """Name of the scan in messages: its path, or the number of its files."""
        return str(self.files[0]) if len(self.files) == 1 else f"{len(self.files):,} files"

    @property
    def saved(self) -> Location | None:
        """The saved model's path, or its URL; None for scans."""
        return self.files[0] if is_saved(self.files[0]) else None

    @property
    def inputs(self) -> dict[str, Any]:
        """All that the points depend on, as JSON values: paths, sizes and times of files, and options of reading.

        If it has changed, all frames of an interrupted animation are rendered again.
        """
        from ..io.inputs import identity_of, stamp

        stamps = [stamp(file) for file in self.files]
        return {
            "scan": [identity_of(file) for file in self.files],
            "scan_bytes": [size for size, _ in stamps],
            "scan_written": [written for _, written in stamps],
            **self.reading.inputs,
        }

    def entry(self, **made: Any) -> Any:
        """Return the place of the scan's model in the cache on disk, as an `Entry`; None if the cache is not used.

        made : arguments with which the model is built; different ones give another place
        """
        from ..model.model_cache import entry_of

        return entry_of(self.files, {"reading": self.reading.inputs, **made}) if self.cached else None

    def check(self) -> None:
        """Raise an error if a file cannot be opened, or has an unknown format or an invalid header."""
        for file in self.files:
            check_scan(file, self.reading.request)

    def verify(self) -> None:
        """Raise an error if this is not a model in parts, or a file of it does not match the hash in its index."""
        from ..model.model_folder import verify_folder

        folder = self.files[0]
        if not self.is_in_parts or not isinstance(folder, Path):
            raise ValueError("--verify requires a model in parts")
        verify_folder(folder)

    @property
    def is_in_parts(self) -> bool:
        """Whether this is a saved model in parts, a folder, which opens its parts when needed."""
        return is_in_parts(self.files[0])

    def read(self, progress: StageProgress | None = None, viewpoint: tuple[float, float, float] | None = None) -> Any:
        """Read the points of the scan, without strays if the options say so; not for saved models.

        viewpoint : scanner position, by which points between an object's edge and its background are found
        """
        from ..io.files import read

        # Files may also be RemoteFiles.
        points = read(self.files, progress=progress, **self.reading.arguments)  # type: ignore[arg-type]
        if not self.reading.drop_strays:
            return points
        from ..cloud.outliers import without_strays

        return without_strays(points, self.name, viewpoint)


def scan_of(paths: Sequence[Location], reading: Reading, cached: bool = False) -> ScanFiles:
    """Return the scan of the paths given to a command; an error if a file is missing, or files cannot be combined.

    paths : files or URLs, or folders that stand for the scans in them; reading : options of reading
    cached : whether the scan's model may come from the cache on disk, and is stored there
    """
    files = files_of(paths)
    saved = next(filter(is_saved, files), None)
    if saved is not None and len(files) > 1:
        raise ValueError(f"{saved}: a saved model cannot be combined with other files, except in view")
    check_unread(files, reading)
    return ScanFiles(tuple(files), reading, cached)


def read_scan(scan: ScanFiles, progress: StageProgress) -> tuple[Any, Any]:
    """Return the points of a scan or of a saved model, and the model, which is None for scans: it is not built here."""
    if scan.saved is None:
        return scan.read(progress), None
    model = load_saved(scan.saved, progress)
    return model.points, model


def load_saved(file: Location, progress: StageProgress) -> Any:
    """Return a saved model, which is downloaded first if it is remote."""
    import pointray as pr

    from ..io.remote.remote_file import local_copy

    with local_copy(file, progress) as path:
        return pr.Model.load(path)


def check_unread(files: Sequence[Location], reading: Reading) -> None:
    """Raise ValueError if options of reading are given, but a file is a saved model, which has its points already."""
    saved = next(filter(is_saved, files), None)
    if saved is not None and not reading.is_plain:
        option = reading.unusual[0].replace("_", "-")
        raise ValueError(f"{saved}: --{option} is for scans, not for saved models")
