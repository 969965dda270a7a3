"""pointray prepare: a scan made smaller, cleaner, or given normals."""

from __future__ import annotations

import math
import os
import warnings
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..choices import AUTO
from ..model_file import SAVED
from ..points.trust import trusted
from ..splats.radii import radii_in
from .scan_scene import check_saved, check_scan
from .waiting import Progress, in_background, writing


def tolerance_of(text: str) -> tuple[float, bool]:
    """`0.5`, or `0.05%` of the diagonal: the number, and whether it is a share."""
    share = text.endswith("%")
    try:
        value = float(text.removesuffix("%"))
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise ValueError(f"--tolerance must be a positive number like 0.5, or like 0.05% of the diagonal, not {text!r}")
    return (value / 100 if share else value), share


def check_output(file: Path, output: Path, force: bool) -> None:
    """Raise what would keep the result from being written, before the work is done; or an input from being kept."""
    from ..points.files import check_writable, written

    if output.suffix.lower() not in (*written(), SAVED):
        extension = output.suffix or "a file without extension"
        raise ValueError(f"{output}: cannot write {extension}; can write {', '.join(written())} and {SAVED}")
    check_writable(output)
    if not force and output.exists() and file.exists() and os.path.samefile(file, output):
        raise ValueError(f"{output}: is the input itself; --force overwrites it")


def read_scan(file: Path, progress: Progress) -> tuple[Any, Any]:
    """The points of a file, and the model if it is a saved one, else None."""
    import pointray as pr

    if file.suffix.lower() != SAVED:
        return pr.read(file, partial(progress.show, "reading")), None
    model = pr.Model.load(file)
    return model.points, model


def surface_of(settings: Any) -> dict[str, Any]:
    """The arguments of `Model` that give the surface of a saved one."""
    trim = "auto" if settings.overhang < math.inf else settings.trim if settings.trim < math.inf else None
    return {"surface": settings.surface, "samples": settings.samples, "refine": settings.refine, "trim": trim}


def prepare(file: Path, output: Path, wishes: dict[str, Any]) -> str:
    """Do what is wished for and write the result; returns a line that says what was done."""
    tolerance = None if wishes["tolerance"] is None else tolerance_of(wishes["tolerance"])
    if tolerance is not None and wishes["count"] is not None:
        raise ValueError("give either --tolerance or --count, not both")
    if wishes["count"] is not None and wishes["count"] < 1:
        raise ValueError(f"--count must be 1 or more, not {wishes['count']}")
    check_output(file, output, wishes["force"])
    check_scan(file)
    check_saved(file, wishes["normals"] == AUTO)
    import pointray as pr

    with Progress() as progress:
        progress.show("reading", 0.0)
        read, model = in_background(lambda: read_scan(file, progress))
        try:
            points, done = in_background(lambda: _prepared(read, tolerance, wishes, progress.show, model is None))
        except ValueError as error:
            raise ValueError(f"{file}: {error}") from error
        if output.suffix.lower() == SAVED:
            surface = {} if model is None else surface_of(model.settings)
            if model is None or points is not read:
                try:
                    model = in_background(lambda: pr.Model(points, radii_in(points), **surface, progress=progress.show))
                except ValueError as error:
                    raise ValueError(f"{file}: {error}") from error
            if not wishes["levels"]:
                model.levels = ()
            elif not model.levels:
                in_background(lambda: model.make_levels(progress.show))
            with writing(output):
                in_background(lambda: model.save(output, lambda share: progress.show("writing", share)))
            return f"{output}: a model of {len(points):,} points; {', '.join(done) or 'nothing else was to be done'}"
    with writing(output):
        pr.write(output, points)
    return f"{output}: {len(points):,} points; {', '.join(done) or 'nothing was to be done'}"


def _prepared(
    points: Any, tolerance: tuple[float, bool] | None, wishes: dict[str, Any], show: Any, is_scan: bool
) -> tuple[Any, Any]:
    import pointray as pr

    from ..points.cleaning import find_flaws
    from ..splats.subsample import find_subsample

    done = []
    if wishes["drop_duplicates"] or wishes["drop_outliers"]:
        show("cleaning", 0.0)
        flaws = find_flaws(points, partial(show, "cleaning"))
        drop = np.zeros(len(points), np.bool_)
        for name, rows in zip(("duplicates", "outliers"), flaws, strict=True):
            if wishes[f"drop_{name}"]:
                drop |= rows
                done.append(f"{int(rows.sum()):,} {name} dropped")
        points = points.select(~drop)
    if wishes["estimate_normals"]:
        show("normals", 0.0)
        points = pr.estimate_normals(points, viewpoint=wishes["viewpoint"], progress=partial(show, "normals"))
        done.append("normals estimated")
    elif is_scan:
        show("normals", 0.0)
        points = trusted(points, wishes["normals"], progress=partial(show, "normals"))
    if tolerance is not None or wishes["count"] is not None:
        before = len(points)
        limit = None
        if tolerance is not None:
            limit = tolerance[0] * (float(np.linalg.norm(np.subtract(*points.bounds))) if tolerance[1] else 1.0)
        found = find_subsample(points, limit, wishes["count"], show)
        if found.message:
            warnings.warn(found.message, stacklevel=2)
        few, attributes = found.points, {**found.points.attributes, "radius": found.radii}
        points = pr.Points.about(few.origin, few.positions, few.normals, few.colors, attributes)
        done.append(f"of {before:,}{_told(found, limit)}")
    return points, done


def _told(found: Any, limit: float | None) -> str:
    """How near the points have the surface that is left of them."""
    from ..splats.subsample import NOISY, SHARE

    if limit is None:
        return ""
    if found.met:
        return f", within {limit:.4g}"
    return f", {found.within:.1%} of them within {limit:.4g} of the surface, not {SHARE:.1%}: {NOISY}"
