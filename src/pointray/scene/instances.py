"""Instances: models and planes with transforms and materials, and the records that kernels read."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base import arguments
from ..base.arguments import ArgumentTypeError
from ..engine.kernels import records as rec
from ..model.model import Model
from ..shade.materials.base import Material
from ..shade.materials.diffuse import Diffuse
from ..surface.tree.instance_bvh import boxes_around
from .paints import ColoredInstance, Paints, PaintTables, check_attribute


@dataclass(frozen=True)
class Plane:
    """An infinite plane.

    Parameters
    ----------
    point, normal : (3,) float
        A point of the plane, and its normal of any length, in world space.
    color : float or (3,) float
        Linear RGB, or a number for grey.
    checker : float, optional
        Edge length of the squares of a checkerboard, in world units; every other square has half the colour. A material
        shows it only if its own colour is None.
    shadow_catcher : bool
        Show only the shadows on the plane: premultiplied black, whose alpha is the blocked fraction of light.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a value is not finite or out of its range.

    Notes
    -----
    The alpha of a shadow catcher is the fraction of the light's luminance that objects block. The integrator "phong"
    counts each light from its centre, and the sky as unshadowed; "ao" counts the occlusion; "path" counts all direct
    light and the sky, as a quotient of sums over a pixel's samples, nearly unbiased from about 4 samples on. Light
    reflected by other surfaces and the plane's material do not count. Other integrators show the plane itself.

    Only the camera's first hit is treated this way: in mirrors, behind glass and for reflected light a shadow catcher
    is an opaque plane of its own colour.

    Alpha is a fraction of linear light. Programs that blend the sRGB values of a PNG show darker shadows; an EXR is
    blended linearly.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> scene.add(pr.Plane(point=(0, 0, -1), normal=(0, 0, 1), checker=0.5))
    0
    >>> scene.intersect([0, 0, 4], [0, 0, -1]).t.item()
    5.0
    """

    point: ArrayLike
    normal: ArrayLike
    color: ArrayLike = 0.5
    checker: float | None = None
    shadow_catcher: bool = False

    def __post_init__(self) -> None:
        arguments.vector(self.point, "point")
        arguments.check_direction(self.normal, "normal")
        arguments.reflectance(self.color, "color")
        arguments.check_flag(self.shadow_catcher, "shadow_catcher")
        if self.checker is not None:
            arguments.check_positive(self.checker, "checker", "a positive length")


class Instances:
    """Table of all instances of a scene, one row each. An instance of a model takes about 200 bytes.

    Attributes
    ----------
    records : (n, 16) float64
        Read by kernels, see `records.INSTANCE`: kind, indices of shape, material and paint, transform.
    boxes : (n, 6) float64
        World bounds of models, min x y z, max x y z; zero for planes.
    numbers : (n,) int64
        The numbers that `Scene.add` returned, increasing.
    shapes : list of Model or Plane
        One item per row.
    materials : list of Material
        One item per row.
    """

    def __init__(self) -> None:
        self._records, self._boxes = np.zeros((8, rec.INSTANCE)), np.zeros((8, 6))
        self._numbers = np.zeros(8, np.int64)
        self.shapes: list[Model | Plane] = []
        self.materials: list[Material] = []
        self._next = 0
        self.paints = Paints()
        # by record and attribute; equal materials are stored once, as long as an instance uses them
        self._equal_materials: WeakValueDictionary[Any, Material] = WeakValueDictionary()

    def __len__(self) -> int:
        return len(self.shapes)

    @property
    def records(self) -> NDArray[np.float64]:
        return self._records[: len(self)]

    @property
    def boxes(self) -> NDArray[np.float64]:
        return self._boxes[: len(self)]

    @property
    def numbers(self) -> NDArray[np.int64]:
        return self._numbers[: len(self)]

    def add(self, shape: Model | Plane, matrix: NDArray[np.float64], material: Material) -> int:
        """Add an instance and return its number, which `Scene.add` returns to the caller.

        matrix : (4, 4), transform from model to world space
        """
        row = len(self)
        if row == len(self._numbers):
            self._records, self._boxes = _grown(self._records), _grown(self._boxes)
            self._numbers = _grown(self._numbers)
        self.shapes.append(shape)
        self.materials.append(material)
        self.paint(row, material)
        self._numbers[row] = self._next
        self._next += 1
        self.move(row, matrix)
        return int(self._numbers[row])

    def row_of(self, number: int) -> int:
        """Return the row of the instance with a number that `add` returned; ValueError if there is no such instance."""
        whole = isinstance(number, int | np.integer) and not isinstance(number, bool)
        row = int(np.searchsorted(self.numbers, min(number, self._next))) if whole else len(self)
        if row == len(self) or self.numbers[row] != number:
            error = ValueError if whole else ArgumentTypeError
            raise error(f"the scene has no instance {number!r}: expected an id that `add` returned")
        return row

    def paint(self, row: int, material: Material) -> None:
        """Set the material of the instance in a row. Equal materials become one object and so share one record."""
        self.materials[row] = self._equal_materials.setdefault(
            (material.record().tobytes(), material.attribute), material
        )

    def move(self, row: int, matrix: NDArray[np.float64]) -> None:
        """Set the transform of the instance in a row, and compute its world bounds.

        matrix : (4, 4), transform from model to world space
        """
        shape = self.shapes[row]
        self._records[row, : rec.TO_MODEL] = 0.0
        if isinstance(shape, Plane):
            self._records[row, rec.KIND] = rec.CATCHER if shape.shadow_catcher else rec.PLANE
            self._records[row, rec.TO_MODEL :] = matrix[:3].reshape(-1)  # a plane stores the transform to world space
            return
        to_model = np.linalg.inv(matrix)[:3]
        to_model[:, 3] -= shape.points.origin
        self._records[row, rec.KIND] = rec.MODEL
        self._records[row, rec.TO_MODEL :] = to_model.reshape(-1)
        low, high = shape.bounds
        corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
        world = corners @ matrix[:3, :3].T + matrix[:3, 3]
        self._boxes[row, :3], self._boxes[row, 3:] = world.min(axis=0), world.max(axis=0)

    def expand_parts(self) -> Instances:
        """Return a copy in which a model split into parts has a row for each part with a surface.

        Without such models return self.
        """
        parts = [_with_surface(shape.parts) if isinstance(shape, Model) else () for shape in self.shapes]
        if not any(parts):
            return self
        twin = self.copy()
        rows = np.repeat(np.arange(len(self)), [len(some) or 1 for some in parts])
        twin._records, twin._boxes, twin._numbers = self.records[rows], self.boxes[rows], self.numbers[rows]
        twin.materials = [self.materials[row] for row in rows]
        twin.shapes = [part for shape, some in zip(self.shapes, parts, strict=True) for part in some or (shape,)]
        for row, shape in enumerate(twin.shapes):
            if isinstance(shape, Model) and parts[rows[row]]:
                bounds = shape.bounds - shape.points.origin
                twin._boxes[row] = boxes_around(twin.records[row, rec.TO_MODEL :].reshape(1, 3, 4), bounds[None])[0]
        return twin

    def detach(self) -> None:
        """Replace the arrays of this table by copies, to be changed while snapshots keep the old ones."""
        self._records, self._boxes, self._numbers = self._records.copy(), self._boxes.copy(), self._numbers.copy()

    def copy(self) -> Instances:
        """Return a copy with independent rows, which shares shapes and materials."""
        twin = object.__new__(type(self))
        twin.__dict__.update(self.__dict__)
        twin.detach()
        twin.shapes, twin.materials = self.shapes.copy(), self.materials.copy()
        twin.paints, twin._equal_materials = copy.copy(self.paints), self._equal_materials.copy()
        return twin

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for `pickle`, without the caches of paints and of equal materials."""
        return {name: value for name, value in self.__dict__.items() if name not in ("paints", "_equal_materials")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.paints, self._equal_materials = Paints(), WeakValueDictionary()
        for row, material in enumerate(self.materials):
            self.paint(row, material)

    def exchange(self, models: Mapping[Model, Model]) -> None:
        """Replace models by others of the same points, such as those built with other options.

        models : the new model of each model to replace; instances keep their transforms and materials
        """
        self.shapes = [models.get(shape, shape) if isinstance(shape, Model) else shape for shape in self.shapes]

    def remove(self, row: int) -> None:
        """Remove the instance in a row; later rows move up, and numbers stay."""
        for array in (self._records, self._boxes, self._numbers):
            array[row : len(self) - 1] = array[row + 1 : len(self)]
        del self.shapes[row], self.materials[row]

    def finish(self) -> tuple[list[Model], NDArray[np.float64], NDArray[np.float64], PaintTables]:
        """Store the indices of each instance's shape, material and paint in its record, and return the tables of these.

        Models on disk are not opened.

        Returns
        -------
        models : list of Model
            The distinct models.
        planes, materials : (m,) float64
            Records one after the other, see `records.PLANE_SIZE` and `records.MATERIAL_SIZE`.
        paints : PaintTables
            Tables that turn the attribute values of coloured instances into colours.
        """
        models, rows = _distinct([shape for shape in self.shapes if isinstance(shape, Model)])
        materials, kinds = _distinct(self.materials)
        is_model = self.records[:, rec.KIND] == rec.MODEL
        self.records[is_model, rec.SHAPE_ROW] = rows
        self.records[:, rec.MATERIAL] = kinds
        flat = np.flatnonzero(~is_model)
        self.records[flat, rec.SHAPE_ROW] = np.arange(len(flat))
        planes = [_plane_record(self.shapes[row], self.records[row, rec.TO_MODEL :], int(row)) for row in flat]
        material_records = np.concatenate([*(m.record() for m in materials), []])
        return models, np.concatenate([*planes, []]), material_records, self._finish_paints()

    def _finish_paints(self) -> PaintTables:
        """Store the index of each instance's paint in its record, -1 without, and return the tables of paints.

        A paint turns values of an attribute into colours; instances whose material shows an attribute have one.
        """
        self.records[:, rec.PAINT] = -1
        rows = [row for row, material in enumerate(self.materials) if material.attribute is not None]
        colored = [self._colored_instance(row) for row in rows]
        self.records[rows, rec.PAINT], tables = self.paints.finish(colored)
        return tables

    def _colored_instance(self, row: int) -> ColoredInstance:
        shape, attribute = self.shapes[row], self.materials[row].attribute
        assert isinstance(shape, Model) and attribute is not None
        return ColoredInstance(attribute, shape, self.records[row, rec.TO_MODEL :].reshape(3, 4))


def _with_surface(parts: tuple[Model, ...]) -> tuple[Model, ...]:
    """Return the parts of a model that a ray can hit; others hold no surface."""
    return tuple(part for part in parts if part.has_surface)


def _grown(array: NDArray[Any]) -> NDArray[Any]:
    """Return the array with twice as many rows."""
    return np.concatenate([array, np.zeros_like(array)])


def _distinct(things: list[Any]) -> tuple[list[Any], list[int]]:
    """Return the distinct objects, by identity, and the index of each object among them."""
    row_of: dict[int, int] = {}
    rows = [row_of.setdefault(id(thing), len(row_of)) for thing in things]
    return list({id(thing): thing for thing in things}.values()), rows


def _plane_record(shape: Any, transform: NDArray[np.float64], row: int) -> NDArray[np.float64]:
    """Return the record of a plane for kernels, (20,) float64: point, normal, colour and checker, in world space.

    transform : (12,), from the plane's coordinates to world space, rows of a 3x4 matrix; row : row of its instance
    """
    matrix = transform.reshape(3, 4)
    normal = np.linalg.inv(matrix[:, :3]).T @ arguments.vector(shape.normal, "normal")
    normal /= np.linalg.norm(normal)
    u = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    u /= np.linalg.norm(u)
    out = np.zeros(rec.PLANE_SIZE)
    out[rec.PLANE_POINT : rec.PLANE_POINT + 3] = matrix[:, :3] @ arguments.vector(shape.point, "point") + matrix[:, 3]
    out[rec.PLANE_NORMAL : rec.PLANE_NORMAL + 3] = normal
    out[rec.PLANE_COLOR : rec.PLANE_COLOR + 3] = arguments.rgb(shape.color, "color")
    out[rec.PLANE_CHECKER] = shape.checker or 0.0
    out[rec.PLANE_U : rec.PLANE_U + 3], out[rec.PLANE_V : rec.PLANE_V + 3] = u, np.cross(normal, u)
    out[rec.PLANE_INSTANCE] = row
    return out


def check_transform(transform: ArrayLike | None) -> NDArray[np.float64]:
    """Return a transform as (4, 4) float64, the identity for None; ValueError if it is singular or not affine."""
    if transform is None:
        return np.eye(4)
    matrix = arguments.check_numbers(transform, "transform", "a (4, 4) array of numbers").astype(np.float64)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError(f"transform must be a (4, 4) array of finite numbers, got shape {matrix.shape}")
    if not np.allclose(matrix[3], [0, 0, 0, 1]):
        raise ValueError(f"transform must have the last row 0 0 0 1, got {matrix[3]}")
    if not np.linalg.cond(matrix[:3, :3]) < 1e7:
        raise ValueError("transform is singular: it flattens the model")
    return matrix


def check_material(material: Material | None, shape: Model | Plane) -> Material:
    """Return a material, `Diffuse` for None, after checks of its values and of its attribute on the shape.

    ValueError if the material shows an attribute that the shape lacks.
    """
    material = Diffuse() if material is None else material
    if not isinstance(material, Material):
        kinds = ", ".join(sorted(kind.__name__ for kind in Material.__subclasses__()))
        raise arguments.wrong_type("material", f"one of {kinds}, or None", material)
    material.record()
    if material.attribute is not None:
        if isinstance(shape, Plane):
            raise ValueError(f"material: planes have no attributes and cannot show {material.attribute.name!r}")
        check_attribute(shape.points, material.attribute)
    return material
