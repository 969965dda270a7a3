"""pointray prepare: makes a scan smaller or cleaner, or gives it normals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..base.choices import AUTO
from ..base.warning_log import warn
from ..cloud.normals.validation import select_normals
from ..io.selection import Selection
from ..io.trajectory import read_trajectory
from ..model.model import SURFACE
from ..model.model_file import SAVED
from ..model.out_of_core.prepare import (
    check_unfinished,
    fits,
    part_points_for,
    prepare as prepare_parts,
    unfinished_part_points,
)
from ..model.out_of_core.split import PART, check_new, split
from ..surface.splats.radii import radii_in
from ..surface.splats.scattered.spheres import Drawing
from ..surface.tree.settings import check_settings
from .cluster import working_on
from .options import smooth_of
from .read_options import Reading
from .scan_files import ScanFiles, check_not_input, check_result, scan_of
from .scan_surface import as_option, check_saved
from .waiting import Progress, in_background, writing


def tolerance_of(text: str) -> tuple[float, bool]:
    """Parse `0.5`, or `0.05%` of the diagonal; return the number and whether it is a share."""
    share = text.endswith("%")
    try:
        value = float(text.removesuffix("%"))
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise ValueError(f"--tolerance must be a positive number like 0.5, or like 0.05% of the diagonal, not {text!r}")
    return (value / 100 if share else value), share


def read_scan(scan: ScanFiles, progress: Progress, viewpoint: Any = None) -> tuple[Any, Any]:
    """Return the points of a scan, and its model if it is a saved one. viewpoint : see `ScanFiles.read`"""
    import pointray as pr

    if scan.saved is None:
        return scan.read(progress.show, viewpoint), None
    model = pr.Model.load(scan.saved)
    return model.points, model


def surface_of(settings: Any) -> dict[str, Any]:
    """Return the arguments of `Model` that repeat the surface of a saved model."""
    trim = "auto" if settings.overhang < math.inf else settings.trim if settings.trim < math.inf else None
    return {"surface": settings.surface, "samples": settings.samples, "refine": settings.refine, "trim": trim}


def drawing_of(options: dict[str, Any]) -> Drawing | None:
    """Return how to draw scattered points; None if no option sets it."""
    scatter, size = options["scatter"], options["scatter_size"]
    if scatter == AUTO and size == 1.0:
        return None
    return Drawing(scatter, size)


def check_parts(output: Path, part_points: int | None) -> None:
    """Raise ValueError if a model in parts cannot be written to a folder."""
    if output.suffix.lower() != SAVED:
        raise ValueError(f"{output}: a model in parts is a folder whose name ends in {SAVED}, like city{SAVED}/")
    if part_points is not None and part_points < 1:
        raise ValueError(f"--part-points must be 1 or more, not {part_points}")
    if check_unfinished(output).exists():
        return
    check_new(output)


IN_MEMORY = "tolerance", "count", "drop_duplicates", "drop_outliers", "smooth", "estimate_normals", "trajectory"


def _goes_by_parts(scan: ScanFiles, reading: Reading, output: Path, options: dict[str, Any]) -> bool:
    """Whether to make a model part by part: for workers, for large scans, or because an earlier run began so."""
    sharing = _sharing(options)
    if scan.saved is not None:
        if sharing:
            raise ValueError(f"{sharing} requires a scan; saved models are split in this process")
        return False
    memory = options["memory"]
    unfinished = check_unfinished(output).exists()
    if not (unfinished or sharing) and fits(scan.files, reading.request, memory):
        return False
    whole = [name for name in IN_MEMORY if options[name] not in (None, False)]
    whole += ["max_points"] * (reading.max_points is not None) + ["drop_strays"] * reading.drop_strays
    if whole and (unfinished or sharing or memory is not None):
        name, instead = whole[0].replace("_", "-"), f"omit {sharing}" if sharing else "read fewer points"
        raise ValueError(f"--{name} requires a scan that fits into memory: omit it, or {instead}")
    return not whole


def _sharing(options: dict[str, Any]) -> str:
    """Return the option that uses workers; empty if there is none."""
    return next((f"--{name}" for name in ("cluster", "workers") if options[name] is not None), "")


def _prepare_parts(scan: ScanFiles, reading: Reading, output: Path, options: dict[str, Any]) -> str:
    """Make a model in parts, part by part; return a line for the user."""
    import pointray as pr

    selection = Selection(reading.every, None, reading.request.bounds, reading.keep, reading.drop)
    settings = check_settings(SURFACE, 4, 1, "auto"), AUTO, drawing_of(options)
    with working_on(options["cluster"], options["workers"]) as client, Progress() as progress:
        most = part_points_for(client, options["memory"])
        size = min(most, options["part_points"] or unfinished_part_points(output) or PART)
        work = partial(prepare_parts, scan.files, (reading.request, selection), output, settings, size)
        count = in_background(lambda: work(partial(progress.show, "preparing"), client, options["levels"]))
    return f"{output}: a model of {count:,} points in {len(pr.Model.load(output).parts)} parts"


def prepare(paths: Sequence[Path], reading: Reading, output: Path, options: dict[str, Any]) -> str:
    """Prepare a scan and write the result; return a line for the user."""
    tolerance = None if options["tolerance"] is None else tolerance_of(options["tolerance"])
    if tolerance is not None and options["count"] is not None:
        raise ValueError("give either --tolerance or --count, not both")
    if options["count"] is not None and options["count"] < 1:
        raise ValueError(f"--count must be 1 or more, not {options['count']}")
    if options["smooth"] is not None:
        smooth_of(options["smooth"])
    if options["in_parts"]:
        check_parts(output, options["part_points"])
    else:
        if _sharing(options):
            raise ValueError(f"{_sharing(options)} requires a model in parts: -o {output.with_suffix(SAVED)}/")
        check_result(output, SAVED)
    drawing = drawing_of(options)
    if drawing is not None and output.suffix.lower() != SAVED:
        raise ValueError(f"--scatter and --scatter-size require a model ({SAVED}), but {output.name} stores points")
    scan = scan_of(paths, reading)
    check_not_input(scan.files, output, options["force"])
    check_saved(scan.files[0], options["normals"] == AUTO and drawing is None)
    scan.check()
    if options["in_parts"] and _goes_by_parts(scan, reading, output, options):
        return _prepare_parts(scan, reading, output, options)
    if options["trajectory"] is not None:  # errors in it come before a large scan is read
        options = {**options, "trajectory": read_trajectory(options["trajectory"])}
    import pointray as pr

    with Progress() as progress:
        progress.show("reading", 0.0)
        read, model = in_background(lambda: read_scan(scan, progress, options["viewpoint"]))
        try:
            points, done = in_background(lambda: _prepared(read, tolerance, options, progress.show, model is None))
        except ValueError as error:
            raise ValueError(f"{scan.name}: {error}") from error
        if output.suffix.lower() == SAVED:
            surface = {} if model is None else surface_of(model.settings)
            drawing = drawing if model is None else model.drawing
            if drawing is not None:
                surface |= {"scatter": drawing.scatter, "scatter_size": drawing.size}
            if model is None or points is not read:
                try:
                    model = in_background(lambda: pr.Model(points, radii_in(points), **surface, progress=progress.show))
                except ValueError as error:
                    raise ValueError(f"{scan.name}: {as_option(error)}") from error
            if options["in_parts"]:
                write = partial(split, model, output, options["part_points"], levels=options["levels"])
                in_background(lambda: write(progress=progress.show))
                made = pr.Model.load(output)
                return f"{output}: a model of {len(made.points):,} points in {len(made.parts)} parts"
            if not options["levels"]:
                model.levels = ()
            elif not model.levels:
                in_background(lambda: model.make_levels(progress.show))
            with writing(output):
                in_background(lambda: model.save(output, progress.show))
            return f"{output}: a model of {len(points):,} points; {', '.join(done) or 'nothing else to do'}"
    with writing(output):
        pr.write(output, points)
    return f"{output}: {len(points):,} points; {', '.join(done) or 'nothing to do'}"


def _prepared(
    points: Any, tolerance: tuple[float, bool] | None, options: dict[str, Any], show: Any, is_scan: bool
) -> tuple[Any, Any]:
    """Return the points after all steps, and descriptions of the steps."""
    import pointray as pr

    from ..cloud.cleaning import find_flaws
    from ..surface.splats.subsample import find_subsample

    done = []
    if options["drop_duplicates"] or options["drop_outliers"]:
        show("cleaning", 0.0)
        flaws = find_flaws(points, show)
        drop = np.zeros(len(points), np.bool_)
        for name, rows in zip(("duplicates", "outliers"), flaws, strict=True):
            if options[f"drop_{name}"]:
                drop |= rows
                done.append(f"{int(rows.sum()):,} {name} dropped")
        points = points.select(~drop)
    if options["smooth"] is not None:
        show("smoothing", 0.0)
        before = points
        points = pr.smooth(points, smooth_of(options["smooth"]), show)
        done.append("no noise found" if points is before else "noise smoothed")
    if options["estimate_normals"]:
        show("normals", 0.0)
        viewpoint = options["viewpoint"]
        if options["trajectory"] is not None:
            viewpoint = pr.eyes_along(points, options["trajectory"])
            done.append(f"{np.isfinite(viewpoint).all(axis=1).mean():.1%} of the points seen along the trajectory")
        points = pr.estimate_normals(points, viewpoint=viewpoint, progress=show)
        done.append("normals estimated")
    elif is_scan:
        show("normals", 0.0)
        points = select_normals(points, options["normals"], progress=show)
    if tolerance is not None or options["count"] is not None:
        before = len(points)
        limit = None
        if tolerance is not None:
            limit = tolerance[0] * (float(np.linalg.norm(np.subtract(*points.bounds))) if tolerance[1] else 1.0)
        # --smooth has been applied above; without it measured noise is smoothed.
        noise: str | float = AUTO if options["smooth"] is None else 0.0
        found = find_subsample(points, limit, options["count"], noise, show)
        if found.message:
            warn(found.message, stacklevel=2)
        points = found.points.changed(attributes={**found.points.attributes, "radius": found.radii})
        done.append(f"of {before:,}{_fit_of(found, limit)}")
    return points, done


def _fit_of(found: Any, limit: float | None) -> str:
    """Return a description of how well the surface of the kept points fits all points."""
    from ..surface.splats.subsample import NOISY, SHARE

    if limit is None:
        return ""
    if found.met:
        return f", within {limit:.4g}"
    return f", {found.within:.1%} of them within {limit:.4g} of the surface, not {SHARE:.1%}: {NOISY}"
