"""Splats in columns -> the files of a model in parts."""

from __future__ import annotations

import secrets
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.tree import LONGEST
from ..model_folder import Index, PartFile, write_columns, write_index, write_part
from ..progress import tell
from ..tree.build import Splats
from ..tree.settings import TreeSettings
from ..tree.top import Groups
from . import layer
from .arrange import CHUNK
from .coarser import ATTRIBUTE, Named
from .columns import Columns
from .layer import Layer
from .levels import write_levels
from .stages import NOISE, PLACED, POSITIONS, Cloud
from .tasks import BORDERS, RADII, SHEETS
from .trees import Plan, bounds_about, cells_of, plan_of, shown, tree_of
from .work import Facts, Work

SHOWN, TREES, LEVELS = 0.05, 0.5, 0.8  # shares of the time after which boxes, trees and levels of detail are there

Span = tuple[float, float]


class Described(NamedTuple):
    """What a model is besides its columns.

    settings, smooth : see `Model`
    attributes : dict of str to str, the columns of the attributes
    optional : tuple of str, those of the columns `BORDERS`, `SHEETS` and `NOISE` that any splat needs
    leveled : whether it gets levels of detail
    """

    settings: TreeSettings
    smooth: str | float
    attributes: dict[str, str]
    optional: tuple[str, ...]
    leveled: bool


class Numbers:
    """The numbers of rows, for slices and for rows."""

    def __getitem__(self, rows: Any) -> NDArray[np.int32]:
        return np.arange(rows.start, rows.stop, dtype=np.int32) if isinstance(rows, slice) else rows.astype(np.int32)


def finish(folder: Path, work: Work, cloud: Cloud, model: Described, span: Span) -> None:
    """Write the trees of the parts, the points and, last, the index."""
    columns, size, id = work.columns, work.size, _id(work.columns)
    if NOISE in model.optional:
        _limit_noise(columns)
    first, grown, leveled = (span[0] + share * (span[1] - span[0]) for share in (SHOWN, TREES, LEVELS))
    shows = work.all(partial(_show, work, cloud, model), (span[0], first), "boxes")
    plan = plan_of(shows, columns[RADII], size)
    grow = partial(_grow, folder, id, work, cloud, model, plan)
    trees = work.each("tree", grow, (first, grown))
    files = [PartFile.of(tree["file"]) for tree in trees]
    if model.leveled:
        whole = _layer_of(work, cloud, model)
        about = Named(folder, id, cloud.origin, cloud.survey, list(model.attributes))
        files = write_levels(work, whole, about, cells_of(plan), files, (grown, leveled))
    named = {name: columns.find(f"points.{name}") for name in ("positions", "normals", "colors")}
    attributes = {name: columns[column] for name, column in model.attributes.items()}
    say = work.watch((leveled, span[1]))
    sizes = write_columns(folder, id, cloud.origin, named, attributes, columns[RADII], lambda share: tell(say, share))
    longest = max(tree["longest"] for tree in trees)
    write_index(folder, _index_of(id, cloud, model, plan, files, (longest, *sizes)))


def _splats_of(cloud: Cloud, model: Described) -> Splats:
    """All splats, in columns that are opened anew."""
    columns = cloud.columns
    arrays: list[Any] = [
        *(columns[PLACED], columns[cloud.normals], columns[RADII], Numbers()),
        columns.find("points.colors"),
        *(columns[name] if name in model.optional else None for name in (BORDERS, SHEETS, NOISE)),
    ]
    return Splats(*arrays)


def _show(work: Work, cloud: Cloud, model: Described, part: int) -> tuple[Groups, NDArray[np.float32]]:
    """What a part shows to the others."""
    return shown(_splats_of(cloud, model), work.size, part)


def _grow(folder: Path, id: str, work: Work, cloud: Cloud, model: Described, plan: Plan, part: int) -> Facts:
    """Write the file of a part with its tree."""
    tree = tree_of(_splats_of(cloud, model), plan, part, model.settings)
    here = work.columns[POSITIONS][work.stretch(part)]
    file = write_part(folder, id, part, len(here), bounds_about(here, cloud.origin), tree)
    return {"file": file.facts, "longest": float(tree.head[LONGEST])}


def _layer_of(work: Work, cloud: Cloud, model: Described) -> Layer:
    """The splats, as levels of detail are made of them."""
    columns = work.columns
    sources: dict[str, Any] = {layer.POSITIONS: PLACED, layer.NORMALS: cloud.normals, layer.RADII: RADII}
    if NOISE in model.optional:
        sources[layer.NOISE] = NOISE
    if "points.colors" in columns:
        sources[layer.COLORS] = "points.colors"
    sources |= {f"{ATTRIBUTE}{k}": column for k, column in enumerate(model.attributes.values())}
    sizes = np.array([rows.stop - rows.start for rows in map(work.stretch, range(work.parts))], np.int64)
    return Layer(0, columns, sizes, sizes, sources)


def _index_of(
    id: str, cloud: Cloud, model: Described, plan: Plan, files: list[PartFile], sizes: tuple[float, int, str]
) -> Index:
    boxes = np.array([file.bounds for file in files])
    bounds = [boxes[:, 0].min(axis=0).tolist(), boxes[:, 1].max(axis=0).tolist()]
    settings = {**model.settings._asdict(), "smooth": model.smooth}
    supports = plan.supports.astype(float).tolist()
    return Index(id, settings, cloud.survey.facts, bounds, supports, *sizes, files)


def _limit_noise(columns: Columns) -> None:
    """Whatever a caller says of the noise, a surface has no bumps higher than its supports."""
    noise, radii = columns[NOISE], columns[RADII]
    for start in range(0, len(radii), CHUNK):
        rows = slice(start, start + CHUNK)
        noise.write(start, np.minimum(noise[rows], radii[rows]))


def _id(columns: Columns) -> str:
    """What all files of the folder name."""
    facts = columns.get("id")
    if facts is None:
        facts = {"id": secrets.token_hex(8)}
        columns.put("id", facts)
    return str(facts["id"])
