"""A model that fits into memory -> the same in parts, in a folder."""

from __future__ import annotations

import os
import secrets
from functools import partial
from pathlib import Path

import numpy as np

from ..arguments import check_callback, check_path, check_whole
from ..model import Model
from ..model_folder import INDEX, Index, write_index, write_points
from ..points.replacing import check_writable
from ..progress import Progress, part_of, tell
from ..tree.parts import splats_of
from .trees import least_size, write_trees

POINTS = 0.3  # share of the time
PART = 1 << 22  # points of a part, if nothing else is asked for


def check_new(path: str | os.PathLike[str]) -> Path:
    """A folder that is empty or can be made; an error if it is neither."""
    folder = Path(path)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ValueError(f"{folder}: there is something already: name a new or an empty folder")
    check_writable(folder / INDEX if folder.exists() else folder)
    return folder


def split(
    model: Model, path: str | os.PathLike[str], part_points: int | None = None, progress: Progress | None = None
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

    Raises
    ------
    OSError
        If the folder or a file cannot be written.
    ValueError
        If the folder is not empty, or the model is in parts itself.
    """
    check_path(path)
    check_callback(progress)
    wanted = PART if part_points is None else check_whole(part_points, "part_points", 1)
    folder = check_new(path)
    model.check_whole()
    there = folder.exists()
    folder.mkdir(exist_ok=True)
    try:
        _write(model, folder, wanted, progress)
    except BaseException:  # Ctrl-C too
        for file in folder.iterdir():
            file.unlink()
        if not there:
            folder.rmdir()
        raise


def _write(model: Model, folder: Path, wanted: int, progress: Progress | None) -> None:
    """Write all files of a folder, the index last."""
    splats = splats_of(model.tree, model.radii)
    points, count = model.points.select(splats.rows), len(splats.rows)
    splats = splats._replace(rows=np.arange(count, dtype=np.int32))
    size = max(1 << (wanted.bit_length() - 1), least_size(count))
    id = secrets.token_hex(8)
    sizes = write_points(folder, id, points, splats.radii, partial(tell, part_of(progress, 0.0, POINTS)))
    trees = write_trees(folder, id, points, splats, size, model.settings, part_of(progress, POINTS, 1.0))
    settings = {**model.settings._asdict(), "smooth": model.smooth}
    index = Index(
        id,
        settings,
        model.points.survey.facts,
        model.bounds.tolist(),
        trees.supports.astype(float).tolist(),
        trees.longest,
        *sizes,
        trees.parts,
    )
    write_index(folder, index)
