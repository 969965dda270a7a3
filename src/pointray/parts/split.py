"""A model that fits into memory -> the same in parts, in a folder."""

from __future__ import annotations

import os
import secrets
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..arguments import check_callback, check_flag, check_path, check_whole
from ..data import Points
from ..model import Model
from ..model_folder import INDEX, Index, write_index, write_points
from ..points.replacing import check_writable
from ..progress import Progress, part_of, tell
from ..tree.build import Splats
from ..tree.parts import splats_of
from . import layer
from .coarser import ATTRIBUTE, Named
from .columns import Columns
from .layer import Layer
from .levels import write_levels
from .trees import cells_of, least_size, write_trees
from .work import Work

POINTS, TREES = 0.2, 0.7  # shares of the time after which points and trees are written
LEVELS = "levels"  # the folder in it that holds what levels of detail are made of, until all is done
PART = 1 << 22  # points of a part, if nothing else is asked for


def check_new(path: str | os.PathLike[str]) -> Path:
    """A folder that is empty or can be made; an error if it is neither."""
    folder = Path(path)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ValueError(f"{folder}: there is something already: name a new or an empty folder")
    check_writable(folder / INDEX if folder.exists() else folder)
    return folder


def split(
    model: Model,
    path: str | os.PathLike[str],
    part_points: int | None = None,
    progress: Progress | None = None,
    levels: bool = True,
) -> None:
    """Write a model in parts, for `Model.load`: rays meet in it what they meet in the model.

    Rows that no splat stands for are left out, and the others are put into the order of the parts.

    Parameters
    ----------
    path : str or path
        A folder, which must be empty or not exist.
    part_points : int, optional
        How many points a part has at most; it has a power of two of them. None: 4 million.
    progress : callable, optional
        Called with the share done.
    levels : bool
        Whether each part gets levels of detail.

    Raises
    ------
    OSError
        If the folder or a file cannot be written.
    ValueError
        If the folder is not empty, the model is in parts itself, or it has scattered points.
    """
    check_path(path)
    check_callback(progress)
    check_flag(levels, "levels")
    wanted = PART if part_points is None else check_whole(part_points, "part_points", 1)
    folder = check_new(path)
    model.check_whole()
    if model.scattered.any():
        raise ValueError("models in parts cannot have scattered points yet: build the model with scatter='surface'")
    there = folder.exists()
    folder.mkdir(exist_ok=True)
    try:
        _write(model, folder, wanted, levels, progress)
    except BaseException:  # Ctrl-C too
        for file in folder.iterdir():
            shutil.rmtree(file) if file.is_dir() else file.unlink()
        if not there:
            folder.rmdir()
        raise


def _write(model: Model, folder: Path, wanted: int, leveled: bool, progress: Progress | None) -> None:
    """Write all files of a folder, the index last."""
    splats = splats_of(model.tree, model.radii)
    points, count = model.points.select(splats.rows), len(splats.rows)
    splats = splats._replace(rows=np.arange(count, dtype=np.int32))
    size = max(1 << (wanted.bit_length() - 1), least_size(count))
    id = secrets.token_hex(8)
    sizes = write_points(folder, id, points, splats.radii, partial(tell, part_of(progress, 0.0, POINTS)))
    grown = part_of(progress, POINTS, TREES if leveled else 1.0)
    trees = write_trees(folder, id, points, splats, size, model.settings, grown)
    files = trees.parts
    if leveled:
        work = Work(Columns(folder / LEVELS), count, size, progress)
        about = Named(folder, id, points.origin, points.survey, list(points.attributes))
        files = write_levels(work, _layer_of(work, splats, points), about, cells_of(trees.plan), files, (TREES, 1.0))
        shutil.rmtree(work.columns.folder)
    settings = {**model.settings._asdict(), "smooth": model.smooth}
    supports = trees.plan.supports.astype(float).tolist()
    bounds = model.bounds.tolist()
    facts = model.points.survey.facts
    write_index(folder, Index(id, settings, facts, bounds, supports, trees.longest, *sizes, files))


def _layer_of(work: Work, splats: Splats, points: Points) -> Layer:
    """The splats, as levels of detail are made of them."""
    named: dict[str, Any] = {layer.POSITIONS: splats.positions, layer.NORMALS: splats.normals}
    named |= {layer.RADII: splats.radii, layer.NOISE: splats.noise, layer.COLORS: points.colors}
    named |= {f"{ATTRIBUTE}{k}": values for k, values in enumerate(points.attributes.values())}
    sources = {name: array for name, array in named.items() if array is not None}
    sizes = np.diff(np.append(np.arange(0, len(points), work.size), len(points)))
    return Layer(0, work.columns, sizes, sizes, sources)
