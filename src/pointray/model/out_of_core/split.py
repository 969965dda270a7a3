"""Conversion of a model in memory to a model in parts."""

from __future__ import annotations

import os
import secrets
import shutil
from pathlib import Path

from ...base.arguments import check_callback, check_flag, check_path, check_whole
from ...base.atomic_write import check_writable
from ...base.disk_columns import Columns
from ...base.progress import Progress, StageProgress, in_stage, part_of
from ...cloud.points import Points
from ...surface.tree.build import Splats
from ...surface.tree.parts import splats_of, surface_of
from ...surface.tree.scattered import scattered_of
from ..model import Model
from ..model_folder import INDEX
from .finish import WrittenParts, finish, finish_loose, finish_surface
from .layer import (
    ATTRIBUTE,
    BORDERS,
    COLORS,
    GIVEN_NORMALS,
    GIVEN_POSITIONS,
    NOISE,
    NORMALS,
    POSITIONS,
    RADII,
    SHEETS,
    Layer,
    finest_layer,
)
from .level_steps import ModelInfo
from .separate_scattered import LOOSE, SURFACE
from .trees import least_size
from .work import Work

POINTS = 0.8  # progress after which the points are written
PART = 1 << 22  # default number of points of a part


def check_new(path: str | os.PathLike[str]) -> Path:
    """Return the path of a folder for a new model; raise a ValueError if it is not empty or is a file.

    Raises
    ------
    ValueError
        If the folder exists and holds something.
    OSError
        If the folder cannot be written.
    """
    folder = Path(path)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise not_empty(folder)
    check_writable(folder / INDEX if folder.exists() else folder)
    return folder


def not_empty(folder: Path) -> ValueError:
    """Return the error for a folder that must be empty but holds something."""
    return ValueError(f"{folder}: already exists and is not empty: choose a new or empty folder")


def split(
    model: Model,
    path: str | os.PathLike[str],
    part_points: int | None = None,
    progress: StageProgress | None = None,
    levels: bool = True,
) -> None:
    """Write a model in memory to a folder as a model in parts; rays have the same hits. `Model.load` opens it.

    Rows without a splat are omitted, and the others are reordered by part: first the surface, then points drawn as
    spheres or discs.

    Parameters
    ----------
    path : str or path
        Folder that is empty or does not exist.
    part_points : int, optional
        Largest number of points of a part; rounded down to a power of two. None: 4 million.
    progress : callable, optional
        Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.
    levels : bool
        Whether each part gets levels of detail.

    Raises
    ------
    OSError
        If the folder or a file cannot be written.
    ValueError
        If the folder is not empty, or the model already is in parts.
    """
    check_path(path)
    check_callback(progress)
    check_flag(levels, "levels")
    wanted = PART if part_points is None else check_whole(part_points, "part_points", 1)
    folder = check_new(path)
    model.check_whole()
    there = folder.exists()
    folder.mkdir(exist_ok=True)
    try:
        _write(model, folder, wanted, levels, in_stage(progress, "writing"))
    except BaseException:  # Ctrl-C too
        for file in folder.iterdir():
            shutil.rmtree(file) if file.is_dir() else file.unlink()
        if not there:
            folder.rmdir()
        raise


def _write(model: Model, folder: Path, wanted: int, leveled: bool, progress: Progress | None) -> None:
    """Write all files of a model in parts, the index file last.

    wanted : largest number of points of a part; leveled : whether parts get levels of detail
    """
    surface, scattered = splats_of(surface_of(model.tree), model.radii), scattered_of(model.tree, model.radii)
    count, apart = len(surface.rows), 0 if scattered is None else len(scattered.rows)
    points, size = model.points, max(1 << (wanted.bit_length() - 1), least_size(max(count, 1)))
    named = ModelInfo(folder, secrets.token_hex(8), points.origin, points.georeference, list(points.attributes))
    middle = count / (count + apart) * POINTS
    all_written: list[WrittenParts] = []
    if count:
        work = Work(Columns(folder / SURFACE), count, size, progress)
        layer = _layer_of(work, surface, points)
        all_written.append(finish_surface(named, work, layer, model.settings, leveled, (0.0, middle)))
    if scattered is not None:
        work, before = Work(Columns(folder / LOOSE), apart, size, progress), all_written[0] if count else None
        layer = _layer_of(work, scattered, points)
        all_written.append(finish_loose(named, work, layer, model.drawing, before, leveled, (middle, POINTS)))
    for name in (SURFACE, LOOSE):
        shutil.rmtree(folder / name, ignore_errors=True)
    settings = {**model.settings._asdict(), "smooth": model.smooth, **model.drawing.facts}
    finish(named, all_written, settings, apart, part_of(progress, POINTS, 1.0), model.bounds.tolist())


def _layer_of(work: Work, splats: Splats, points: Points) -> Layer:
    """Return splats of a model and their points as the finest layer: level 0 of the levels of detail of all parts.

    points : all points of the model, from which those of the splats are selected
    """
    points = points.select(splats.rows)
    sources = {
        POSITIONS: splats.positions,
        NORMALS: splats.normals,
        RADII: splats.radii,
        NOISE: splats.noise,
        BORDERS: splats.borders,
        SHEETS: splats.sheets,
        GIVEN_POSITIONS: points.positions,
        GIVEN_NORMALS: points.normals,
        COLORS: points.colors,
        **{f"{ATTRIBUTE}{k}": values for k, values in enumerate(points.attributes.values())},
    }
    return finest_layer(work, sources)
