"""Paints: tables in which kernels look up the colours of attributes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles, Floats
from ..cloud.points import Points, categories_of, spread_rows
from ..engine.kernels import records as rec
from ..image.tone import srgb_to_linear
from ..model.model import Model
from ..shade.attributes import COORDINATES, Attribute, category_colors
from ..shade.colormaps import colormap, shows_classes

LOW, HIGH = 2, 98  # percentiles of the default range
SAMPLE = 100_000  # number of points whose coordinates determine the range
NEUTRAL = (128, 128, 128)  # sRGB, for missing values

EVERY, NOTHING = slice(None), slice(0)

Range = tuple[float, float]
Rows = slice | NDArray[np.integer[Any]]


def column_of(points: Points, name: str, rows: Rows = EVERY) -> NDArray[Any]:
    """Return the values of an attribute, (n,); of vectors their lengths, as float64.

    ValueError if there is no such attribute.

    name : "name[k]" is column k of a vector attribute; rows : rows of the points, a slice or row numbers
    """
    column = None if name in points.attributes else re.fullmatch(r"(.+)\[(\d+)\]", name)
    found = points.attributes.get(column[1] if column else name)
    if found is None or (column and (found.ndim == 1 or int(column[2]) >= found.shape[1])):
        known = [n if v.ndim == 1 else f"{n}[0..{v.shape[1] - 1}]" for n, v in points.attributes.items()]
        names = ", ".join([*sorted(known), *COORDINATES])
        raise ValueError(f"the points have no attribute {name!r}; available: {names}")
    values = found[rows, int(column[2])] if column else found[rows]
    return values if values.ndim == 1 else np.asarray(np.linalg.norm(values.astype(np.float64), axis=1))


def check_attribute(points: Points, attribute: Attribute) -> None:
    """Raise ValueError if the points lack the attribute that a material shows; coordinates (x, y, z) always exist."""
    if attribute.name not in COORDINATES:
        column_of(points, attribute.name, NOTHING)


# Finding categories reads all values. The parts of a model share the result.
_CATEGORIES: WeakKeyDictionary[Any, dict[str, tuple[int, ...] | None]] = WeakKeyDictionary()


def categories_in(model: Model, name: str) -> tuple[int, ...] | None:
    """Return the categories of an attribute of a model's points: its few distinct values, which are never blended.

    The result is None if the values are not categories; it is cached.
    """
    known = _CATEGORIES.setdefault(model if model.source is None else model.source.cache, {})
    if name not in known:
        known[name] = categories_of(column_of(model.points, name), name)
    return known[name]


class ColoredInstance(NamedTuple):
    """An instance whose material shows an attribute of its model's points.

    to_model : (3, 4) float64, transform from world to model space
    """

    attribute: Attribute
    model: Model
    to_model: Doubles


class PaintTables(NamedTuple):
    """Tables by which kernels colour instances from attribute values; fields of `World` with these names.

    paints : (k * 8,), records: the kind of look-up, and where values and colours of a paint begin in the other tables
    map_positions : (n,), for each splat the place of its value in the colour map: 0 to its number of colours, or NaN
    map_colors : (m * 3,), linear RGB of all colour maps, each followed by its colour for missing values
    """

    paints: Doubles
    map_positions: Floats
    map_colors: Floats


Painted = tuple[Attribute, Model]


class JoinedPositions(NamedTuple):
    """Cached map positions (places of attribute values in a colour map, one a splat) of several models, concatenated.

    painted : the attribute and model of each piece, in order; positions : the pieces, one after the other
    on_disk : the pieces of models on disk, to be reused when other models are opened
    """

    painted: list[Painted]
    positions: Floats
    on_disk: dict[Painted, Floats]


class Paints:
    """The paints of a scene: tables that turn the attribute values of coloured instances into colours.

    Ranges and map positions (places of values in a colour map) are cached and never modified, so copies share them.

    Attributes
    ----------
    shown : list of Attribute
        The distinct attributes of the last `finish`, with the ranges that are shown.
    paint_sources : list of (Attribute, Model or None)
        The attribute that each paint shows, and the model; None for a coordinate.
    """

    def __init__(self) -> None:
        self.shown: list[Attribute] = []
        self.paint_sources: list[tuple[Attribute, Model | None]] = []
        self._ranges: dict[tuple[Any, ...], Range | None] = {}
        self._joined = JoinedPositions([], np.zeros(0, np.float32), {})

    def finish(self, colored: list[ColoredInstance]) -> tuple[list[int], PaintTables]:
        """Return the index of each instance's paint, and the tables of all paints. Models on disk are not opened.

        A paint is a record that turns the values of an attribute into colours. Instances of one model that show the
        same attribute share a paint. After the paint of a model come those of its levels of detail.
        """
        shown = self._find_ranges(colored)
        self.shown = list(shown.values())
        wanted = [(shown[c.attribute], None if c.attribute.name in COORDINATES else c.model) for c in colored]
        paints: list[tuple[Attribute, Model | None]] = []
        row_of: dict[tuple[Attribute, Model | None], int] = {}
        for paint in dict.fromkeys(wanted):
            row_of[paint] = len(paints)
            paints += [paint, *_coarser(*paint)]
        here = [(attribute, model) for attribute, model in paints if model is not None and model.source is None]
        colors = [np.concatenate([_table(a), [NEUTRAL]]).astype(np.uint8) for a in self.shown]
        starts = dict(zip(self.shown, np.cumsum([0, *(c.size for c in colors)]), strict=False))
        records = np.zeros((len(paints), rec.PAINT_SIZE))
        for record, (attribute, model) in zip(records, paints, strict=True):
            record[rec.PAINT_COLORS], record[rec.PAINT_COUNT] = starts[attribute], len(_table(attribute))
            if model is None:
                _record_coordinate(record, attribute)
                continue
            record[rec.PAINT_KIND] = rec.CLASSES if _has_classes(attribute) else rec.BLENDED
            record[rec.PAINT_COARSER] = len(_coarser(attribute, model))
        linear = srgb_to_linear(np.concatenate([*colors, np.zeros((0, 3), np.uint8)]))
        self.paint_sources = paints
        tables = PaintTables(*self.place(records.reshape(-1), paints, here), linear.reshape(-1))
        return [row_of[paint] for paint in wanted], tables

    def place(
        self, paints: Doubles, paint_sources: Sequence[tuple[Attribute, Model | None]], painted: list[Painted]
    ) -> tuple[Doubles, Floats]:
        """Return the records of paints, and the map positions of the splats of some models, which are opened.

        A paint turns attribute values into colours; a map position is the place of a splat's value in the colour map.
        The returned records say where in the map positions those of each model begin.

        paints : (k * 8,), records of all paints; paint_sources : the attribute and model of each paint
        painted : attributes and models whose map positions are computed and concatenated, in this order
        """
        found = self._join(painted)
        lengths = [len(model.tree.order) for _, model in painted]
        starts = dict(zip(painted, np.cumsum([0, *lengths]).tolist(), strict=False))
        records = paints.reshape(-1, rec.PAINT_SIZE).copy()
        for record, (attribute, model) in zip(records, paint_sources, strict=True):
            if model is not None:
                record[rec.PAINT_POSITIONS] = starts.get((attribute, model), 0)
        return records.reshape(-1), found

    def _find_ranges(self, colored: list[ColoredInstance]) -> dict[Attribute, Attribute]:
        """Return each attribute with the range or the categories that are shown: as given, or found from the points.

        colored : the coloured instances; an automatic range is the union of those of all that show the attribute
        """
        known, self._ranges = self._ranges, {}
        spans: dict[Attribute, list[Range]] = {instance.attribute: [] for instance in colored}
        categories = {attribute: _categories(attribute, colored) for attribute in spans}
        for instance in colored:
            attribute = instance.attribute
            if attribute.range is None and categories[attribute] is None:
                where = instance.to_model.tobytes() if attribute.name in COORDINATES else b""
                key = (instance.model.points, attribute.name, shows_classes(attribute.colormap), where)
                self._ranges[key] = known[key] if key in known else _range_of(instance)
                span = self._ranges[key]
                spans[attribute] += [] if span is None else [span]
        shown = {}
        for a, found in spans.items():
            if categories[a] is not None:
                shown[a] = replace(a, categories=categories[a])
            else:
                shown[a] = a if a.range is not None else replace(a, range=_widest(found))
        return shown

    def _join(self, painted: list[Painted]) -> Floats:
        """Return the map positions (places of values in the colour map) of all splats of some models, concatenated.

        painted : attributes and models; cached positions of models on disk are reused
        """
        known = self._joined
        if painted == known.painted:
            return known.positions
        found = [known.on_disk[one] if one in known.on_disk else _map_positions(*one) for one in painted]
        joined = found[0] if len(found) == 1 else np.concatenate([*found, np.zeros(0, np.float32)])
        on_disk = {one: array for one, array in zip(painted, found, strict=True) if one[1].source is not None}
        self._joined = JoinedPositions(painted, joined, on_disk)
        return joined


def _coarser(attribute: Attribute, model: Model | None) -> list[tuple[Attribute, Model | None]]:
    """Return the attribute and model of the paints for a model's levels of detail: none if the attribute has classes.

    A paint is a record that turns attribute values into colours. A mean of classes is meaningless, so such models are
    shown with all points. Only models on disk, whose parts may not fit into memory, use levels, which show the most
    frequent class.

    model : None if the attribute is a coordinate, which needs no such paints
    """
    if model is None or (_has_classes(attribute) and model.source is None):
        return []
    return [(attribute, level) for level in model.levels]


def _has_classes(attribute: Attribute) -> bool:
    """Return whether an attribute has categories or a colour map of classes; such values are never blended.

    attribute : as shown, with the categories that were found
    """
    return bool(attribute.values) or shows_classes(attribute.colormap)


def _table(attribute: Attribute) -> NDArray[np.uint8]:
    """Return the colours of an attribute, (n, 3) uint8 sRGB: one for each category, or those of its colour map.

    attribute : as shown, with the categories that were found
    """
    return category_colors(attribute) if attribute.values else colormap(attribute.colormap)


def _categories(attribute: Attribute, colored: list[ColoredInstance]) -> tuple[int, ...] | None:
    """Return the categories of an attribute: those given, or the union of those of all models that show it.

    None if it has none: a model's values are not categories, or the attribute has a range or a map of classes.
    """
    if not attribute.may_have_categories:
        return attribute.values or None
    found = [categories_in(instance.model, attribute.name) for instance in colored if instance.attribute == attribute]
    known = [values for values in found if values is not None]
    return tuple(sorted(set().union(*known))) if len(known) == len(found) else None


def _range_of(instance: ColoredInstance) -> Range | None:
    """Return the automatic range of an attribute on one instance, (low, high), or None if no value is finite.

    It spans the 2nd to the 98th percentile, or all values if these are equal; for a map of classes, 0 to the largest.
    Coordinates are taken in world space, of a sample of the points. Models on disk are sampled too.
    """
    if instance.attribute.name in COORDINATES:
        rows = instance.model.points.positions
        step = -(-len(rows) // SAMPLE)
        rows = rows[::step] if instance.model.source is None else rows[spread_rows(len(rows), SAMPLE)]
        to_world = np.linalg.inv(instance.to_model[:, :3])[COORDINATES.index(instance.attribute.name)]
        values = (rows - instance.to_model[:, 3]) @ to_world
    else:
        points = instance.model.points
        some = EVERY if instance.model.source is None else spread_rows(len(points))
        values = column_of(points, instance.attribute.name, some).astype(np.float64)
    values = values[np.isfinite(values)]
    if len(values) == 0:
        return None
    if shows_classes(instance.attribute.colormap):
        return 0.0, float(max(np.rint(values.max()), 1.0))
    low, high = np.percentile(values, [LOW, HIGH])
    if low == high:  # nearly all values are equal: the range must show the few others
        low, high = values.min(), values.max()
    return float(low), float(high)


def _widest(ranges: list[Range]) -> Range:
    """Return the union of ranges (low, high), widened if it is a single value; 0 to 1 without any ranges."""
    low, high = (min(r[0] for r in ranges), max(r[1] for r in ranges)) if ranges else (0.0, 1.0)
    room = max(0.5, 1e-6 * abs(low)) if low == high else 0.0
    return low - room, high + room


def _map_positions(attribute: Attribute, model: Model) -> Floats:
    """Return the place in the colour map of each splat's value, (n,), in the order of the model's tree.

    Places go from 0 to the number of colours; values outside the range are clamped, and unknown categories are NaN.
    """
    order = model.tree.order
    used = np.flatnonzero(order >= 0)
    values = column_of(model.points, attribute.name, order[used])
    out = np.zeros(len(order), np.float32)
    if attribute.values:
        known = np.array(attribute.values)
        row = np.minimum(np.searchsorted(known, values), len(known) - 1)
        out[used] = np.where(known[row] == values, row, np.nan)
        return out
    assert attribute.range is not None
    low, high = attribute.range
    values = values.astype(np.float64)
    count = len(colormap(attribute.colormap))
    if shows_classes(attribute.colormap):
        out[used] = np.mod(np.rint(np.clip(values, low, high) - low), count)
    else:
        out[used] = np.clip((values - low) / (high - low), 0, 1) * count
    return out


def _record_coordinate(record: Doubles, attribute: Attribute) -> None:
    """Store in a paint's record the linear function from a world coordinate to the place in the colour map.

    record : (8,), to be filled, by which kernels colour an instance; attribute : x, y or z, with its range
    """
    assert attribute.range is not None
    low, high = attribute.range
    scale = len(colormap(attribute.colormap)) / (high - low)
    record[rec.PAINT_KIND] = rec.BY_COORDINATE
    record[rec.PAINT_ALONG + COORDINATES.index(attribute.name)] = scale
    record[rec.PAINT_START] = -low * scale
