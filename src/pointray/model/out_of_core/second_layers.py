"""Search for second layers across parts, continuing from part to part like `cloud/outliers/search.py`."""

from __future__ import annotations

from functools import partial

import numpy as np

from ...cloud.outliers.floors import LEAST, FloorSearch
from ...cloud.outliers.search import LayerSearch, block_size
from .local import Local
from .stages import LAYERS, Cloud, ordering_of
from .work import Facts, Work

OPEN, NEW = 1, 2  # values of the column of blocks


def find_layers(work: Work, cloud: Cloud, span: tuple[float, float]) -> None:
    """Write which ranges of the kd order contain second layers, such as those of misaligned scans, unless already done.

    The column `LAYERS` gets a value for each range of up to 2,048 points, not 0 where its points must be examined.

    span : begin and end of this stage, as fractions of all work
    """
    columns, count = work.columns, -(-cloud.total // block_size(cloud.total))
    if columns.get(LAYERS) is not None:
        return
    states = np.zeros(count, np.int8)
    facts = work.each("layers", partial(_show, work, cloud), span)
    while True:
        found = np.concatenate([np.array(fact["blocks"], np.int64) for fact in facts])
        new = found[states[found] == 0]
        states[states == NEW], states[new] = OPEN, NEW
        columns.fill(LAYERS, states)
        if not len(new):
            break
        facts = work.all(partial(_follow, work, cloud), (span[1], span[1]), "layers")
    columns.put(LAYERS, {})


def _show(work: Work, cloud: Cloud, part: int) -> Facts:
    """Find second layers in the middles of a part's ranges (up to 2,048 points in kd order), where the search begins.

    A second layer is a duplicate of a surface, from a misaligned scan.

    Returns
    -------
    dict
        blocks : numbers of the ranges that show one.
    """
    search = _search(cloud, work.local(part))
    own = _blocks_of(work, cloud, part)
    found = np.zeros(0, np.int64) if search is None else search.seeds()
    return {"blocks": found[(found >= own.start) & (found < own.stop)].tolist()}


def _follow(work: Work, cloud: Cloud, part: int) -> Facts:
    """Examine the ranges of a part that were newly found to have a second layer: a duplicate, from a misaligned scan.

    Returns
    -------
    dict
        blocks : numbers of the ranges, also of other parts, in which these layers may continue.
    """
    own = _blocks_of(work, cloud, part)
    new = own.start + np.flatnonzero(work.columns[LAYERS][own] == NEW)
    search = _search(cloud, work.local(part)) if len(new) else None
    return {"blocks": [] if search is None else search.open(new).tolist()}


def _blocks_of(work: Work, cloud: Cloud, part: int) -> slice:
    """Return the numbers of a part's ranges of the kd order (up to 2,048 points), as a slice."""
    size, rows = block_size(cloud.total), work.part_rows(part)
    return slice(rows.start // size, -(-rows.stop // size))


def _search(cloud: Cloud, local: Local) -> LayerSearch | None:
    """Return a search for second layers (duplicates of a surface, from misaligned scans) among the points of a part.

    The points include those of the part's margin. None if there are too few."""
    ordering = ordering_of(cloud.points(local).positions)
    if len(ordering.positions) < LEAST:
        return None
    return LayerSearch(FloorSearch(ordering.positions), cloud.total, local.rows[ordering.rows])
