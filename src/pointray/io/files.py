"""`read` and `write`: one file or several to one cloud, and back."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..base import arguments
from ..base.atomic_write import replacing
from ..base.manual import noted
from ..base.progress import Progress, StageProgress, in_stage
from ..base.warning_log import warn
from ..cloud.conversion import PointsLike, check_points
from ..cloud.points import MOST, Points
from .formats._source import Format, Request
from .gather import gather
from .inputs import Paths, check_exists, check_format, check_unchanged, located, paths_of, pieces_of, stamp
from .known_formats import writer_of
from .opening import Opener, named
from .remote.remote_file import Location, RemoteFile, location_of
from .selection import Selection, checked_bounds
from .unpacking import packing_of


def read(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    columns: str | Sequence[str] | None = None,
    every: int = 1,
    max_points: int | None = None,
    bounds: ArrayLike | None = None,
    keep: Mapping[str, ArrayLike] | None = None,
    drop: Mapping[str, ArrayLike] | None = None,
    resolution: float | None = None,
    sample: int | None = None,
    opacity: float = 0.1,
    intrinsics: Sequence[float] | None = None,
    strict: bool = False,
    progress: StageProgress | None = None,
) -> Points:
    """Read a point cloud from one file, or from several files as one cloud.

    The format is detected from the contents of a file, not from its name; `formats` lists the supported ones. Files
    compressed with gzip or Zstandard (.gz, .zst) are decompressed first.

    Files can be URLs: http, https, s3, gs and others that fsspec knows. They are downloaded to a temporary folder,
    which is removed afterwards. Of COPC files with `bounds` or `resolution`, only the needed parts are fetched.

    Parameters
    ----------
    path : str or path, or sequence of these
        Files of one cloud, or their URLs as str.
    columns : sequence of str, or str with commas, optional
        Names of the columns of a text file or of a file of float32 rows: x, y, z, nx, ny, nz, r, g, b or attribute
        names; "-" skips a column. Default: detected.
    every : int
        Read every n-th row.
    max_points : int, optional
        Maximum number of points, evenly spread over the rows.
    bounds : (2, 3) or (6,) array_like, optional
        Box of the points to read, in the file's coordinates. COPC files are read only where they overlap it.
    keep, drop : dict of str to number or sequence of numbers, optional
        Keep or drop the rows whose attribute has one of these values: ``keep={"classification": [2, 6]}``.
    resolution : float, optional
        Coarsest acceptable point spacing: COPC files are read down to this level of detail. Default: all points.
    sample : int, optional
        Number of points to sample on the triangles of a mesh; 0 reads the vertices. Default: the vertices, unless they
        are too sparse to represent the surface: then 200,000 points are sampled, with a warning.
    opacity : float
        Gaussian splats with a lower opacity, 0 to 1, are left out.
    intrinsics : sequence of float, optional
        fx, fy, cx, cy of a depth image in pixels, optionally followed by the number of depth steps per unit of length.
    strict : bool
        Refuse files that are truncated, inconsistent or refer to a missing file. Otherwise the available data are read,
        and a warning names what is missing.
    progress : callable, optional
        Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

    Returns
    -------
    Points
        The selected rows, in the order of the files. `georeference` has the coordinate system and scanner positions.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    OSError
        If a file cannot be opened, or a download fails.
    ImportError
        If the format, or a URL, needs a package that is not installed.
    ValueError
        If the format of a file is unknown, its contents are damaged or contain no points, or memory is insufficient.

    Examples
    --------
    >>> pr.write("sphere.ply", pr.procedural("sphere", 1000))
    >>> points = pr.read("sphere.ply", every=2)
    >>> len(points), points.colors.dtype
    (500, dtype('uint8'))
    """
    arguments.check_callback(progress)
    request = request_of(columns, bounds, resolution, sample, opacity, intrinsics, strict)
    selection = Selection(every, max_points, request.bounds, keep, drop)  # type: ignore[arg-type]  # it checks them
    with open_files(path, request, progress) as files:
        return gather(files, selection, in_stage(progress, "reading"))


@contextmanager
def open_files(path: Paths, request: Request, progress: StageProgress | None = None) -> Iterator[list[Opener]]:
    """Detect the formats of one file or several; yield an `Opener` for each (its name, and the function that opens it).

    Compressed files stay unpacked while the context lasts, and files given as URLs stay downloaded.

    request : options of reading for the formats; progress : called while files are downloaded

    Raises
    ------
    OSError
        If a file cannot be opened.
    ValueError
        If the format of a file is unknown, or, on exit, if a file has been modified meanwhile.
    """
    with noted(), ExitStack() as stack:
        files = paths_of(path, stack)
        before = [stamp(file) for file in files]
        openers = [
            Opener(str(file), partial(format.open, there, request))
            for file in files
            for format, there in [located(file, request, stack, progress)]
        ]
        try:
            yield openers
        except ValueError as error:
            check_unchanged(files, before, error)
            raise
        check_unchanged(files, before)


def request_of(
    columns: Any = None,
    bounds: Any = None,
    resolution: Any = None,
    sample: Any = None,
    opacity: Any = 0.1,
    intrinsics: Any = None,
    strict: Any = False,
) -> Request:
    """Check the options of reading that depend on the format of a file; return them together.

    columns : names of the columns of a text file; bounds : (2, 3) or (6,), box of the points to read
    resolution : coarsest acceptable point spacing (COPC); sample : number of points to sample on a mesh
    opacity : minimum opacity of Gaussian splats; intrinsics : fx, fy, cx, cy of a depth image
    strict : refuse damaged files
    """
    names = columns.split(",") if isinstance(columns, str) else columns
    if names is not None:
        if not isinstance(names, Sequence) or not names or not all(isinstance(n, str) and n.strip() for n in names):
            raise arguments.wrong("columns", "names like x,y,z,r,g,b", columns)
        names = tuple(name.strip() for name in names)
        for axis in "xyz":
            if [name.lower() for name in names].count(axis) != 1:
                raise ValueError(f"columns must name {axis} once: {','.join(names)}")
    return Request(
        names,
        None if bounds is None else checked_bounds(bounds),
        None if resolution is None else arguments.check_positive(resolution, "resolution"),
        None if sample is None else arguments.check_whole(sample, "sample", 0, MOST, or_none=True),
        arguments.check_number(opacity, "opacity", "a number from 0 to 1", lambda x: 0 <= x <= 1),
        None if intrinsics is None else _checked_intrinsics(intrinsics),
        arguments.check_flag(strict, "strict"),
    )


def _checked_intrinsics(value: Any) -> tuple[float, ...]:
    wanted = "fx,fy,cx,cy or fx,fy,cx,cy,steps (depth steps per unit of length)"
    numbers = arguments.check_numbers(value, "intrinsics", wanted).astype(np.float64)
    if numbers.shape not in ((4,), (5,)) or not np.isfinite(numbers).all() or min(*numbers[:2], *numbers[4:]) <= 0:
        raise arguments.wrong("intrinsics", wanted, value)
    return tuple(numbers.tolist())


def check_readable(path: str | os.PathLike[str] | RemoteFile, request: Request | None = None) -> None:
    """Raise OSError or ValueError if a file cannot be opened, or its format is unknown or its header invalid.

    Compressed files are not examined, because that would unpack them. Of remote files only the format is checked,
    except of those that are read in pieces. request : options of reading for the format
    """
    file, asked = check_exists(location_of(path)), request or Request()
    if isinstance(file, RemoteFile) and pieces_of(file, asked) is None:
        return check_format(file)
    if isinstance(file, Path) and packing_of(file):
        return None
    with ExitStack() as stack:
        format, there = located(file, asked, stack)
        with named(str(file)), format.open(there, asked):
            pass


def write(
    path: str | os.PathLike[str], points: PointsLike, progress: StageProgress | None = None, *, compressed: bool = False
) -> None:
    """Write a point cloud with all its arrays. The extension of the file selects the format; `formats` lists them all.

    Parameters
    ----------
    path : str or path
        An existing file is replaced once the new one is complete.
    points : Points, or what `as_points` accepts
        Written in world coordinates. A warning names what the format cannot store.
    progress : callable, optional
        Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.
    compressed : bool
        Write PCD as binary_compressed instead of binary. Other formats are compressed or not by their extension: .laz,
        .las.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    OSError
        If the file cannot be written.
    ImportError
        If the format needs a package that is not installed.
    ValueError
        If no format with this extension can be written, or not `compressed`, or the format cannot store the name of an
        attribute.

    Examples
    --------
    >>> pr.write("sphere.ply", pr.procedural("sphere", 1000))
    >>> len(pr.read("sphere.ply"))
    1000
    """
    arguments.check_callback(progress)
    for lost in write_points(path, points, in_stage(progress, "writing"), compressed):
        warn(f"{path}: {lost}", stacklevel=2)


def write_points(
    path: str | os.PathLike[str], points: PointsLike, progress: Progress | None = None, compressed: bool = False
) -> list[str]:
    """Write a point cloud in the format that the extension of the file selects; return what the format cannot store.

    Each item of the list is a text for the user, such as "cannot store the scanner positions".

    compressed : whether the format's compressed variant is written
    """
    points = check_points(points)
    writer = writer_of(path, arguments.check_flag(compressed, "compressed"))
    with replacing(path) as beside, named(str(path)):
        return writer(beside, points, progress)


def headers(path: Paths, request: Request | None = None) -> Iterator[tuple[Location, Format, Any]]:
    """Yield (file, format, listing) for each of one file or several, without reading their points.

    The `Listing` is what the header announces: the number of rows, the georeference, and facts for `pointray info`.

    request : options of reading for the formats
    """
    for file in paths_of(path):
        with ExitStack() as stack:
            format, there = located(file, request or Request(), stack)
            with format.open(there, request or Request()) as source:
                yield file, format, source.listing
