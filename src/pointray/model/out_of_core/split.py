"""Conversion of a model in memory to a model in parts."""

from __future__ import annotations

import os
import secrets
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...base.arguments import check_callback, check_flag, check_path, check_whole
from ...base.atomic_write import check_writable
from ...base.disk_columns import Columns
from ...base.progress import Progress, StageProgress, in_stage, part_of, report_progress
from ...cloud.points import Points
from ...surface.tree.build import Splats
from ...surface.tree.parts import splats_of, surface_of
from ...surface.tree.scattered import scattered_of
from ..model import Model
from ..model_folder import INDEX, Index, PartFile, write_index, write_points
from . import layer
from .layer import Layer
from .level_steps import ATTRIBUTE, ModelInfo
from .levels import write_levels
from .scattered_parts import LooseParts, write_loose_levels, write_loose_part
from .trees import Trees, cells_of, least_size, write_trees
from .work import Work

POINTS, TREES = 0.2, 0.6  # progress after the points, and after the trees of the surface
LEVELS, LOOSE = "levels", "loose"  # subfolders for intermediate data of levels of detail
PART = 1 << 22  # default number of points of a part


def check_new(path: str | os.PathLike[str]) -> Path:
    """Validate that a folder is empty or can be made."""
    folder = Path(path)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ValueError(f"{folder}: already exists and is not empty: choose a new or empty folder")
    check_writable(folder / INDEX if folder.exists() else folder)
    return folder


def split(
    model: Model,
    path: str | os.PathLike[str],
    part_points: int | None = None,
    progress: StageProgress | None = None,
    levels: bool = True,
) -> None:
    """Write a model in parts, to be opened by `Model.load`; rays have the same hits as in the model.

    Rows without a splat are omitted, and the others are reordered by part: first the surface, then scattered points.

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
    """Write all files of a folder, the index last."""
    surface, found = splats_of(surface_of(model.tree), model.radii), scattered_of(model.tree, model.radii)
    count, apart = len(surface.rows), 0 if found is None else len(found.rows)
    rows = surface.rows if found is None else np.concatenate([surface.rows, found.rows])
    radii = surface.radii if found is None else np.concatenate([surface.radii, found.radii])
    points = model.points.select(rows)
    size, id = max(1 << (wanted.bit_length() - 1), least_size(max(count, 1))), secrets.token_hex(8)
    sizes = write_points(folder, id, points, radii, partial(report_progress, part_of(progress, 0.0, POINTS)))
    about = ModelInfo(folder, id, points.origin, points.georeference, list(points.attributes))
    ends = np.array([0.0, count / len(rows), 1.0]) * (1.0 - POINTS) + POINTS
    files: list[PartFile] = []
    median, longest, supports = None, 0.0, []
    if count:
        mine = points.select(np.arange(count))
        median = float(np.median(surface.radii))
        surface = surface._replace(rows=np.arange(count, dtype=np.int32))
        trees = _write_surface(about, mine, surface, size, model, leveled, part_of(progress, ends[0], ends[1]))
        files, longest, supports = trees.parts, trees.longest, [trees.plan.supports.astype(float).tolist()]
    if found is not None:
        layer = _layer_of(folder / LOOSE, size, found, points.select(np.arange(count, len(rows))))
        loose = LooseParts(layer, model.drawing, len(files), count)
        more, boxes = _write_loose(about, loose, (median, files), leveled, part_of(progress, ends[1], ends[2]))
        files, supports = [*files, *more], [*supports, *boxes]
    settings = {**model.settings._asdict(), "smooth": model.smooth, **model.drawing.facts}
    box = [*np.min(supports, axis=0)[:3].tolist(), *np.max(supports, axis=0)[3:].tolist()]
    facts = model.points.georeference.facts
    write_index(folder, Index(id, settings, facts, model.bounds.tolist(), box, longest, *sizes, files, apart))


def _write_surface(
    about: ModelInfo, points: Points, splats: Splats, size: int, model: Model, leveled: bool, progress: Progress | None
) -> Trees:
    """Write the parts of the surface."""
    grown = part_of(progress, 0.0, TREES if leveled else 1.0)
    trees = write_trees(about.folder, about.id, points, splats, size, model.settings, grown)
    if not leveled:
        return trees
    layer = _layer_of(about.folder / LEVELS, size, splats, points)
    work = Work(layer.columns, len(points), size, progress)
    files = write_levels(work, layer, about, cells_of(trees.plan), trees.parts, (TREES, 1.0))
    shutil.rmtree(layer.columns.folder)
    return trees._replace(parts=files)


def _write_loose(
    about: ModelInfo,
    loose: LooseParts,
    surface: tuple[float | None, list[PartFile]],
    leveled: bool,
    progress: Progress | None,
) -> tuple[list[PartFile], list[list[float]]]:
    """Write the parts of scattered points; return their index entries, and the bounds of their spheres."""
    layer, facts = loose.layer, []
    for part in range(len(layer.sizes)):
        facts.append(write_loose_part(about, loose, part))
        report_progress(progress, 0.5 * (part + 1) / len(layer.sizes))
    files = [PartFile.of(fact["file"]) for fact in facts]
    if leveled:
        work = Work(layer.columns, layer.total, int(layer.sizes[0]), progress)
        files = write_loose_levels(work, loose, about, surface, files, (0.5, 1.0))
    shutil.rmtree(layer.columns.folder)
    return files, [fact["supports"] for fact in facts]


def _layer_of(folder: Path, size: int, splats: Splats, points: Points) -> Layer:
    """Return splats as the finest layer of levels of detail."""
    named: dict[str, Any] = {layer.POSITIONS: splats.positions, layer.NORMALS: splats.normals}
    named |= {layer.RADII: splats.radii, layer.NOISE: splats.noise, layer.COLORS: points.colors}
    named |= {f"{ATTRIBUTE}{k}": values for k, values in enumerate(points.attributes.values())}
    sources = {name: array for name, array in named.items() if array is not None}
    sizes = np.diff(np.append(np.arange(0, len(points), size), len(points)))
    return Layer(0, Columns(folder), sizes, sizes, sources)
