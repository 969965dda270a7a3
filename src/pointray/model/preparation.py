"""`prepare`: files to a smaller or cleaner scan, or to a saved model."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import check_callback, check_path
from ..base.choices import AUTO
from ..base.executor import Client, backend
from ..base.progress import StageProgress, in_stage
from ..base.warning_log import warn
from ..cloud.cleaning import find_flaws
from ..cloud.conversion import PointsLike, check_points
from ..cloud.denoising.smooth import smooth as smooth_points
from ..cloud.normals.estimate import estimate_normals
from ..cloud.normals.validation import select_normals
from ..cloud.outliers import without_strays
from ..cloud.points import MOST, Points
from ..io.exchange.columns import selected
from ..io.exchange.convert import is_path, is_paths
from ..io.files import open_files, request_of, write
from ..io.gather import gather
from ..io.inputs import fetch, locations_of
from ..io.remote.remote_file import Location, local_copy
from ..io.selection import Selection
from ..io.trajectory import Trajectory, eyes_along, read_trajectory
from ..surface.splats.radii import radii_in
from ..surface.splats.subsample import NOISY, SHARE, Subsample, find_subsample
from ..surface.tree.settings import check_settings
from .building import ignore_progress
from .model import SURFACE, Model
from .out_of_core.prepare import (
    check_unfinished,
    fits,
    part_points_for,
    prepare as prepare_parts,
    unfinished_part_points,
)
from .out_of_core.split import PART, split
from .preparation_options import SEPARATORS, Cleaning, NormalsChoice, PreparationOptions, ReadOptions, Storage
from .scan_inputs import check_not_input, check_scan, files_of, is_saved


@dataclass(frozen=True)
class Prepared:
    """Result of `prepare`: what was written; `str` describes it in one line.

    Attributes
    ----------
    path : Path
        The file or the folder that was written.
    points : int
        Number of its points.
    parts : int
        Number of its parts; 0 if it is a file.
    steps : tuple of str
        Descriptions of what was done to the points.

    Examples
    --------
    >>> pr.write("scan.ply", pr.procedural("sphere", 1000))
    >>> pr.prepare("scan.ply", "model.pointray").points
    1000
    """

    path: Path
    points: int
    parts: int = 0
    steps: tuple[str, ...] = ()

    def __str__(self) -> str:
        model = "a model of " if is_saved(self.path) else ""
        if self.parts:
            return f"{self.path}: {model}{self.points:,} points in {self.parts} parts"
        nothing = "nothing else to do" if model else "nothing to do"
        return f"{self.path}: {model}{self.points:,} points; {', '.join(self.steps) or nothing}"


def prepare(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | PointsLike,
    out: str | os.PathLike[str],
    *,
    tolerance: float | str | None = None,
    count: int | None = None,
    drop_duplicates: bool = False,
    drop_outliers: bool = False,
    drop_strays: bool = False,
    smooth: float | str | None = None,
    normals: str = AUTO,
    viewpoint: ArrayLike | None = None,
    trajectory: str | os.PathLike[str] | Trajectory | None = None,
    scatter: str = AUTO,
    scatter_size: float = 1.0,
    levels: bool = True,
    in_parts: bool | None = None,
    part_points: int | None = None,
    memory: int | None = None,
    force: bool = False,
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
    client: Client | None = None,
    progress: StageProgress | None = None,
) -> Prepared:
    """Make a scan smaller or cleaner, give it normals, or save its model: `pointray prepare` as a function.

    Steps follow each other in the order of the parameters. The radii of subsampled points are stored in the attribute
    radius, which `pointray` and models of files use.

    Parameters
    ----------
    paths : path, or sequence of paths, or what `as_points` accepts
        Scans, which are read as one cloud, folders of scans, or one saved model; or URLs of files, see `read`; or
        points in memory.
    out : path
        .pointray: a saved model, or a folder with a model in parts; otherwise a format that `write` supports. Existing
        files are replaced once the new one is complete.
    tolerance : float or str, optional
        Drop points while the surface changes by at most this: a length in the points' unit, or a share of the diagonal
        like "0.05%".
    count : int, optional
        Keep this many points. Give either this or the tolerance.
    drop_duplicates, drop_outliers : bool
        Drop equal positions, and points far away from all others; see `find_flaws`.
    drop_strays : bool
        Drop points that belong to no surface; see `find_strays`.
    smooth : "auto" or float, optional
        Move noisy points onto the surface; the standard deviation of the noise in the points' unit, "auto": measured.
        See the function `smooth`.
    normals : {"auto", "file", "fit"}
        "auto": the file's normals unless they are wrong; "file": those of the file; "fit": estimated ones.
    viewpoint : (3,) array_like, optional
        Scanner position, for `normals="fit"` and `drop_strays`, instead of that in the file.
    trajectory : path or Trajectory, optional
        Path of a moving scanner, for `normals="fit"`; see `eyes_along`.
    scatter : {"auto", "spheres", "discs", "surface", "none"}
        How a model draws points that lie on no surface, such as leaves and wires; see `Model`.
    scatter_size : float
        Factor for the radii of points drawn as spheres or discs.
    levels : bool
        Whether a model gets levels of detail, a third more bytes.
    in_parts : bool, optional
        Whether to write a model in parts. Default: if `out` is a str that ends in a slash, or if `part_points` or
        `memory` are given.
    part_points : int, optional
        Points per part, rounded down to a power of two. Default: 4194304.
    memory : int, optional
        Bytes. A model in parts that needs more on a machine is made part by part; an interrupted call can be repeated
        and continues. Default: the available memory.
    force : bool
        Whether `out` may be one of the inputs.
    columns : str or sequence of str, optional
        Names of the columns of a text file; see `read`.
    every, max_points, bounds, keep, drop : optional
        Which points to read: every n-th row, at most this many evenly spread rows, a world box (2, 3), attribute values
        to keep or to drop; see `read`.
    resolution, sample, opacity, intrinsics, strict : optional
        How to read files with levels of detail, meshes, Gaussian splats, depth images and damaged files; see `read`.
    client : dask.distributed.Client, optional
        Its workers make the parts of a model in parts. They must be able to write to the folder.
    progress : callable, optional
        Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

    Returns
    -------
    Prepared
        The path that was written, the number of points and parts, and descriptions of the steps.

    Raises
    ------
    OSError
        If a file cannot be read or written.
    ValueError
        If a parameter or a file is invalid, or parameters exclude each other.

    Examples
    --------
    >>> pr.write("scan.ply", pr.procedural("sphere", 5000))
    >>> print(pr.prepare("scan.ply", "small.ply", count=1000))
    small.ply: 1,000 points; of 5,000
    >>> pr.prepare("scan.ply", "city.pointray/").parts
    1
    """
    check_callback(progress)
    client = None if client is None else backend().check_client(client)
    path = check_path(out, "out")
    if in_parts is None:
        slash = isinstance(out, str) and out.endswith(SEPARATORS)
        in_parts = slash or part_points is not None or memory is not None
    request = request_of(columns, bounds, resolution, sample, opacity, intrinsics, strict)
    selection = Selection(every, max_points, request.bounds, keep, drop)  # type: ignore[arg-type]  # it checks them
    options = PreparationOptions(
        Storage(path, in_parts, part_points, memory, levels, force, scatter, scatter_size),
        Cleaning(tolerance, count, drop_duplicates, drop_outliers, smooth),
        NormalsChoice(normals, viewpoint, trajectory),
        ReadOptions(request, selection, drop_strays),
        client is not None,
    )
    with ExitStack() as stack:
        inputs: Any = locations_of(paths, "paths", stack) if is_path(paths) or is_paths(paths) else paths
        plan = plan_preparation(inputs, options, progress)
        if plan.by_parts:
            return prepare_by_parts(plan, client, progress)
        return write_result(plan, prepare_in_memory(plan, progress), progress)


class Plan(NamedTuple):
    """Checked inputs and options of a call of `prepare`.

    Attributes
    ----------
    files : list of Path or RemoteFile
        Scans, or one saved model.
    options : PreparationOptions
    by_parts : bool
        Whether to make a model in parts one part at a time, without all points in memory.
    points : Points or None
        Points in memory instead of files.
    """

    files: list[Location]
    options: PreparationOptions
    by_parts: bool
    points: Points | None = None

    @property
    def name(self) -> str:
        """Name of the scan in messages: the path of its only file, or the number of files."""
        if self.points is not None:
            return "points"
        return str(self.files[0]) if len(self.files) == 1 else f"{len(self.files):,} files"

    @property
    def is_saved(self) -> bool:
        """Whether the input is a saved model."""
        return self.points is None and is_saved(self.files[0])


class Result(NamedTuple):
    """Result of the steps of `prepare` that run in memory, before it is written.

    points : the prepared points; model : the model of them, None if points are to be written
    steps : descriptions of what was done to the points
    """

    points: Points
    model: Model | None
    steps: tuple[str, ...]


def plan_preparation(paths: Any, options: PreparationOptions, progress: StageProgress | None = None) -> Plan:
    """Find and check the input files of `prepare`; decide whether a model is made one part at a time.

    For the decision, remote files are downloaded.

    paths : files or folders, as given to `prepare`; progress : called while files are downloaded
    """
    if not (is_path(paths) or is_paths(paths) or (isinstance(paths, list | tuple) and not paths)):
        return _plan_for_points(check_points(paths, "paths"), options)
    files, storage, named = files_of(paths), options.storage, options.named
    plan = Plan(files, options, False)
    saved = next(filter(is_saved, files), None)
    if saved is not None and len(files) > 1:
        raise ValueError(f"{saved}: a saved model cannot be combined with other files, except in view")
    if saved is not None and options.reading.unusual:
        raise ValueError(f"{saved}: {named(options.reading.unusual[0])} is for scans, not for saved models")
    check_not_input(files, storage.out, storage.force, named("force"))
    if saved is not None and (options.normals.normals == "file" or storage.drawing is not None):
        names = f"{named('scatter')}, {named('scatter_size')} and {named('normals')}"
        raise ValueError(f"{saved}: {names} are part of a saved model")
    for file in files:
        check_scan(file, options.reading.request)
    if storage.in_parts and not plan.is_saved:
        fetch(files, options.reading.request, progress)
    return plan._replace(by_parts=storage.in_parts and _goes_by_parts(plan))


def _plan_for_points(points: Points, options: PreparationOptions) -> Plan:
    """Check the options of `prepare` for points in memory."""
    if options.shared:
        raise ValueError(f"{options.named('client')} requires the paths of scans, not points in memory")
    return Plan([], options, False, points)


def _goes_by_parts(plan: Plan) -> bool:
    """Return whether to make a model one part at a time: for workers, for large scans, or to resume such a run.

    Raises
    ------
    ValueError
        If it is necessary, but an option requires all points in memory, or if workers cannot split a saved model.
    """
    options = plan.options
    shared, memory, named = options.shared, options.storage.memory, options.named
    if plan.is_saved:
        if shared:
            raise ValueError(f"{named('client')} requires a scan; saved models are split in this process")
        return False
    must = shared or check_unfinished(options.storage.out).exists()
    if not must and fits(plan.files, options.reading.request, memory):
        return False
    whole = options.in_memory
    if whole and (must or memory is not None):
        instead = f"omit {named('client')}" if shared else "read fewer points"
        raise ValueError(f"{named(whole[0])} requires a scan that fits into memory: omit it, or {instead}")
    return not whole


def prepare_by_parts(plan: Plan, client: Any = None, progress: StageProgress | None = None) -> Prepared:
    """Make a model in parts from scans, one part at a time, and write it; return what was written.

    client : Dask client whose workers make the parts; None: this process
    """
    storage, reading = plan.options.storage, plan.options.reading
    settings = check_settings(SURFACE, 4, 1, "auto"), AUTO, storage.drawing
    most = part_points_for(client, storage.memory)
    size = min(most, int(storage.part_points or 0) or unfinished_part_points(storage.out) or PART)
    work = partial(prepare_parts, plan.files, (reading.request, reading.selection), storage.out, settings, size)
    count = work(in_stage(progress, "preparing"), client, bool(storage.levels))
    return Prepared(storage.out, count, len(Model.load(storage.out).parts))


def prepare_in_memory(plan: Plan, progress: StageProgress | None = None) -> Result:
    """Read a scan or a saved model and do all steps on its points, in memory; build a model if one is to be written."""
    options, report = plan.options, progress or ignore_progress
    flight = options.normals.trajectory
    if isinstance(flight, str | os.PathLike):  # errors in it come before a large scan is read
        options = replace(options, normals=replace(options.normals, trajectory=read_trajectory(flight)))
    report("reading", 0.0)
    saved = None
    if plan.is_saved:
        with local_copy(plan.files[0], report) as path:
            saved = Model.load(path)
    read = _read(plan, report) if saved is None else saved.points
    try:
        points, steps = _prepared(read, options, report, saved is None)
        if not options.storage.is_model:
            return Result(points, None, tuple(steps))
        model = saved if points is read and saved is not None else _model_of(points, saved, options, report)
    except ValueError as error:
        text = str(error)
        text = options.named("scatter") + text.removeprefix("scatter") if text.startswith("scatter: ") else text
        raise ValueError(f"{plan.name}: {text}") from error
    if not options.storage.in_parts:
        if not options.storage.levels:
            model.levels = ()
        elif not model.levels:
            model.make_levels(progress)
    return Result(points, model, tuple(steps))


def write_result(plan: Plan, result: Result, progress: StageProgress | None = None) -> Prepared:
    """Write the prepared points, or the model as a file or in parts; return what was written."""
    storage, points, model = plan.options.storage, result.points, result.model
    if model is None:
        write(storage.out, points, progress)
    elif storage.in_parts:
        size = None if storage.part_points is None else min(int(storage.part_points), MOST)
        split(model, storage.out, size, progress, bool(storage.levels))
        made = Model.load(storage.out)
        return Prepared(storage.out, len(made.points), len(made.parts), result.steps)
    else:
        model.save(storage.out, progress)
    return Prepared(storage.out, len(points), 0, result.steps)


def _read(plan: Plan, report: StageProgress) -> Points:
    """Read all files of a scan as one cloud, without strays if the options drop these."""
    reading, viewpoint = plan.options.reading, plan.options.normals.viewpoint
    if plan.points is not None:
        points = selected(plan.points, reading.selection)
    else:
        with open_files(plan.files, reading.request, report) as files:
            points = gather(files, reading.selection, in_stage(report, "reading"))
    return without_strays(points, plan.name, viewpoint) if reading.drop_strays else points


def _prepared(
    points: Points, options: PreparationOptions, report: StageProgress, is_scan: bool
) -> tuple[Points, list[str]]:
    """Drop, smooth and subsample points and give them normals, as the options say.

    Returns
    -------
    points : Points
        The points after all steps.
    steps : list of str
        Descriptions of the steps, for the user.
    """
    cleaning = options.cleaning
    done: list[str] = []
    if cleaning.drop_duplicates or cleaning.drop_outliers:
        points = _cleaned(points, cleaning, done, report)
    if cleaning.smooth is not None:
        report("smoothing", 0.0)
        before = points
        points = smooth_points(points, cleaning.smooth, report)
        done.append("no noise found" if points is before else "noise smoothed")
    if options.normals.normals == "fit":
        points = _with_normals(points, options.normals, done, report)
    elif is_scan:
        report("normals", 0.0)
        points = select_normals(points, options.normals.normals, options.named("file"), report)
    if cleaning.tolerance is not None or cleaning.count is not None:
        points = _subsampled(points, cleaning, done, report)
    return points, done


def _cleaned(points: Points, cleaning: Cleaning, done: list[str], report: StageProgress) -> Points:
    """Return the points without duplicates and outliers, if these are to be dropped; append descriptions to `done`."""
    report("cleaning", 0.0)
    flaws = find_flaws(points, report)
    drop = np.zeros(len(points), np.bool_)
    for name in flaws._fields:
        if getattr(cleaning, f"drop_{name}"):
            rows = getattr(flaws, name)
            drop |= rows
            done.append(f"{int(rows.sum()):,} {name} dropped")
    return points.select(~drop)


def _with_normals(points: Points, choice: NormalsChoice, done: list[str], report: StageProgress) -> Points:
    """Return the points with estimated normals, turned to the scanner if it is known; append descriptions to `done`."""
    report("normals", 0.0)
    viewpoint = choice.viewpoint
    if choice.trajectory is not None:
        viewpoint = eyes_along(points, choice.trajectory)
        done.append(f"{np.isfinite(viewpoint).all(axis=1).mean():.1%} of the points seen along the trajectory")
    done.append("normals estimated")
    return estimate_normals(points, viewpoint=viewpoint, progress=report)


def _subsampled(points: Points, cleaning: Cleaning, done: list[str], report: StageProgress) -> Points:
    """Return a subsample of the points, with support radii as the attribute "radius"; append its description.

    done : descriptions of the steps, which the description is appended to
    """
    limit = None
    if cleaning.tolerance is not None:
        limit = cleaning.limit(float(np.linalg.norm(np.subtract(*points.bounds))))
    # Noise has been smoothed if the caller said how; otherwise measured noise is smoothed here.
    noise: str | float = AUTO if cleaning.smooth is None else 0.0
    found = find_subsample(points, limit, cleaning.count, noise, report)
    if found.message:
        warn(found.message, stacklevel=2)
    done.append(f"of {len(points):,}{_describe_fit(found, limit)}")
    return found.points.changed(attributes={**found.points.attributes, "radius": found.radii})


def _describe_fit(found: Subsample, limit: float | None) -> str:
    """Return text about the share of all points within a distance of the subsample's surface; empty without a limit.

    limit : the tolerance, in the points' unit; None if a number of points was wanted
    """
    if limit is None:
        return ""
    if found.met:
        return f", within {limit:.4g}"
    return f", {found.within:.1%} of them within {limit:.4g} of the surface, not {SHARE:.1%}: {NOISY}"


def _model_of(points: Points, saved: Model | None, options: PreparationOptions, report: StageProgress) -> Model:
    """Build a model of prepared points.

    saved : an existing model whose surface settings and drawing of scattered points are reused; None: default settings,
        and scattered points are drawn as the options say
    """
    settings = check_settings(SURFACE, 4, 1, AUTO) if saved is None else saved.settings
    drawing = options.storage.drawing if saved is None else saved.drawing
    scatter, size = (AUTO, 1.0) if drawing is None else drawing
    trim = AUTO if settings.overhang < math.inf else settings.trim if settings.trim < math.inf else None
    return Model(
        points,
        radii_in(points),
        surface=settings.surface,
        samples=settings.samples,
        refine=settings.refine,
        trim=trim,
        scatter=scatter,
        scatter_size=size,
        progress=report,
    )
