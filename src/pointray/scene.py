"""Scene: models and planes, each at its place, lights and a background; and rays cast at all of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .image.tone import srgb_to_linear
from .model import Model
from .records import (
    INSTANCE,
    KIND,
    MATERIAL,
    MODEL,
    MODEL_ROW,
    PLANE,
    PLANE_CHECKER,
    PLANE_COLOR,
    PLANE_NORMAL,
    PLANE_POINT,
    PLANE_U,
    PLANE_V,
    TO_MODEL,
    World,
    model_table,
)
from .shade.lights import PointLight, SunLight, rgb, vector
from .shade.materials import Diffuse, Material
from .trace.cast import blend_attribute, closest_hits, occlusions


@dataclass(frozen=True)
class Plane:
    """An endless plane.

    Parameters
    ----------
    point, normal : (3,) float, world
    color : float or (3,) float, linear
    checker : float, optional
        Edge of the squares of a checker; every other one has half the colour.
    """

    point: ArrayLike
    normal: ArrayLike
    color: ArrayLike = 0.5
    checker: float | None = None

    def __post_init__(self) -> None:
        vector(self.point, "point")
        if not vector(self.normal, "normal").any():
            raise ValueError("normal must not be zero")
        rgb(self.color, "color")
        if self.checker is not None and not 0 < self.checker < np.inf:
            raise ValueError(f"checker must be a positive length, not {self.checker!r}")


@dataclass(frozen=True)
class Hits:
    """What rays of the shape (...) met first.

    Attributes
    ----------
    t : (...) float32
        In lengths of the ray's direction; inf for a miss.
    position : (..., 3) float64
        World; NaN for a miss.
    normal : (..., 3) float32
        Unit, where the points' normals point: never turned to the ray; 0 for a miss.
    color : (..., 3) float32
        Linear, blended with the surface's weights; 0 for a miss, 1 for points without colours.
    point : (...) int64
        Row, in the caller's points, of the splat of most weight; -1 for a miss and for a plane.
    instance : (...) int32
        What `Scene.add` returned; -1 for a miss.
    attributes : dict of str to (...) or (..., k) float32
        Those asked for, blended; NaN for a miss and where the model has no such attribute.
    """

    t: NDArray[np.float32]
    position: NDArray[np.float64]
    normal: NDArray[np.float32]
    color: NDArray[np.float32]
    point: NDArray[np.int64]
    instance: NDArray[np.int32]
    attributes: dict[str, NDArray[np.float32]] = field(default_factory=dict)


@dataclass(frozen=True)
class _Instance:
    shape: Model | Plane
    transform: NDArray[np.float64]
    material: Material


class Scene:
    """Models and planes under lights.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> bust = scene.add(pr.Model(pr.procedural("statue", 100_000)))
    >>> hits = scene.intersect([0, -5, 1.5], [0, 1, 0])
    >>> hits.t, hits.point
    """

    def __init__(self) -> None:
        self._instances: dict[int, _Instance] = {}
        self._lights: dict[int, PointLight | SunLight] = {}
        self._background: NDArray[np.float64] | None = None
        self._next = 0
        self._built: tuple[World, list[int], list[Model]] | None = None

    def add(self, shape: Model | Plane, transform: ArrayLike | None = None, material: Material | None = None) -> int:
        """Put a model or a plane into the scene.

        Parameters
        ----------
        transform : (4, 4) array_like, optional
            To world space, for column vectors: rigid, scaled, mirrored or sheared, not singular.
        material : Diffuse or Phong, optional
            None: diffuse in the points' own colours.

        Returns
        -------
        int
            The number of this instance.
        """
        if not isinstance(shape, Model | Plane):
            raise ValueError(f"a scene holds Model and Plane, not {type(shape).__name__}")
        number = self._next
        self._instances[number] = _Instance(shape, _check_transform(transform), _check_material(material))
        self._next += 1
        self._built = None
        return number

    def update(self, id: int, transform: ArrayLike | None = None, material: Material | None = None) -> None:
        """Move an instance, or give it another material; None leaves either as it is."""
        old = self._find(id)
        if transform is not None:
            old = replace(old, transform=_check_transform(transform))
        if material is not None:
            old = replace(old, material=_check_material(material))
        self._instances[id] = old
        self._built = None

    def remove(self, id: int) -> None:
        """Take an instance out."""
        self._find(id)
        del self._instances[id]
        self._built = None

    def add_light(self, light: PointLight | SunLight) -> int:
        """Put a light into the scene; without any there is a headlight at the camera."""
        if not isinstance(light, PointLight | SunLight):
            raise ValueError(f"a light is a PointLight or a SunLight, not {type(light).__name__}")
        light.record()
        number = len(self._lights)
        self._lights[number] = light
        self._built = None
        return number

    @property
    def background(self) -> NDArray[np.float64] | None:
        """Linear RGB behind everything, or None: transparent."""
        return self._background

    @background.setter
    def background(self, color: ArrayLike | None) -> None:
        self._background = None if color is None else rgb(color, "background")

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Least and greatest world coordinates of all models, (2, 3) float64; ValueError if there is none."""
        corners = [_corners(i) for i in self._instances.values() if isinstance(i.shape, Model)]
        if not corners:
            raise ValueError("the scene holds no model")
        all_corners = np.concatenate(corners)
        return np.stack([all_corners.min(axis=0), all_corners.max(axis=0)])

    def intersect(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_min: ArrayLike = 0,
        t_max: ArrayLike = np.inf,
        *,
        attributes: tuple[str, ...] | list[str] = (),
    ) -> Hits:
        """The closest hit of each ray.

        A ray that starts on a surface (within 1% of a support radius) starts outside of it: it is not blocked by the
        points around its origin when it leaves to where the normal points, and is when it goes inside.

        Parameters
        ----------
        origins, directions : (..., 3) array_like
            World; they and t_min, t_max are broadcast. A direction that is zero or not finite misses.
        t_min, t_max : (...) array_like
            The part of the ray that counts, in lengths of the direction.
        attributes : sequence of str
            Which of the points' attributes to blend at the hits.

        Raises
        ------
        ValueError
            If shapes do not broadcast, a dtype is no number, or no model has an attribute of that name.
        """
        shape, rays = _check_rays(origins, directions, t_min, t_max)
        world, numbers, _ = self._world()
        found = closest_hits(world, *rays)
        row = found["instance"]
        blended = {name: self._blend(name, found, shape) for name in attributes}
        instance = np.append(np.array(numbers, np.int32), np.int32(-1))[row]
        return Hits(
            found["t"].reshape(shape),
            found["position"].reshape(*shape, 3),
            found["normal"].reshape(*shape, 3),
            found["color"].reshape(*shape, 3),
            found["point"].reshape(shape),
            instance.reshape(shape),
            blended,
        )

    def occluded(
        self, origins: ArrayLike, directions: ArrayLike, t_min: ArrayLike = 0, t_max: ArrayLike = np.inf
    ) -> NDArray[np.bool_]:
        """Whether each ray meets anything between t_min and t_max: (...) bool; parameters as for `intersect`."""
        shape, rays = _check_rays(origins, directions, t_min, t_max)
        return occlusions(self._world()[0], *rays).reshape(shape)

    def _blend(self, name: str, found: dict[str, Any], shape: tuple[int, ...]) -> NDArray[np.float32]:
        world, _, models = self._world()
        known = {a for m in models for a in m.points.attributes}
        if name not in known:
            raise ValueError(f"no model has an attribute {name!r}; there are: {', '.join(sorted(known)) or 'none'}")
        widths = {m.points.attributes[name].shape[1:] for m in models if name in m.points.attributes}
        if len(widths) > 1:
            raise ValueError(f"attribute {name!r} has not the same number of columns in all models")
        out = np.full((len(found["t"]), *widths.pop()), np.nan, np.float32)
        kinds = world.instances.reshape(-1, INSTANCE)
        for i, kind in enumerate(kinds):
            rows = np.flatnonzero(found["instance"] == i)
            model = int(kind[MODEL_ROW])
            if kind[KIND] == MODEL and len(rows) and name in models[model].points.attributes:
                out[rows] = blend_attribute(world, found, rows, model, models[model].points.attributes[name])
        return out.reshape(*shape, *out.shape[1:])

    def _find(self, id: int) -> _Instance:
        if id not in self._instances:
            raise ValueError(f"the scene has no instance {id!r}")
        return self._instances[id]

    def _world(self) -> tuple[World, list[int], list[Model]]:
        """What kernels read, the instances' numbers in its order, and the models (kept alive)."""
        if self._built is None:
            models = list(
                {id(i.shape): i.shape for i in self._instances.values() if isinstance(i.shape, Model)}.values()
            )
            row = {id(model): k for k, model in enumerate(models)}
            records = [_record(i, row) for i in self._instances.values()]
            for k, record in enumerate(records):
                record[MATERIAL] = k
            empty = np.zeros(0)
            world = World(
                model_table([m.tree for m in models]),
                np.concatenate([*records, empty]),
                np.concatenate([*(light.record() for light in self._lights.values()), empty]),
                np.concatenate([*(i.material.record() for i in self._instances.values()), empty]),
                srgb_to_linear(np.arange(256, dtype=np.uint8)),
                16 * max([int(m.tree.spans[1::2].max()) for m in models], default=1),
            )
            self._built = world, list(self._instances), models
        return self._built


def _record(instance: _Instance, row: dict[int, int]) -> NDArray[np.float64]:
    """An instance as kernels read it, see `records.INSTANCE`."""
    out = np.zeros(INSTANCE)
    shape, matrix = instance.shape, instance.transform
    inverse = np.linalg.inv(matrix)
    if isinstance(shape, Model):
        out[KIND], out[MODEL_ROW] = MODEL, row[id(shape)]
        to_model = inverse[:3].copy()
        to_model[:, 3] -= shape.points.origin
        out[TO_MODEL : TO_MODEL + 12] = to_model.reshape(-1)
        return out
    normal = inverse[:3, :3].T @ vector(shape.normal, "normal")
    normal /= np.linalg.norm(normal)
    u = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    u /= np.linalg.norm(u)
    out[KIND] = PLANE
    out[PLANE_POINT : PLANE_POINT + 3] = matrix[:3, :3] @ vector(shape.point, "point") + matrix[:3, 3]
    out[PLANE_NORMAL : PLANE_NORMAL + 3] = normal
    out[PLANE_COLOR : PLANE_COLOR + 3] = rgb(shape.color, "color")
    out[PLANE_CHECKER] = shape.checker or 0.0
    out[PLANE_U : PLANE_U + 3], out[PLANE_V : PLANE_V + 3] = u, np.cross(normal, u)
    return out


def _corners(instance: _Instance) -> NDArray[np.float64]:
    assert isinstance(instance.shape, Model)
    low, high = instance.shape.bounds
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
    return np.asarray(corners @ instance.transform[:3, :3].T + instance.transform[:3, 3])


def _check_transform(transform: ArrayLike | None) -> NDArray[np.float64]:
    if transform is None:
        return np.eye(4)
    try:
        matrix = np.array(transform, np.float64)
    except (TypeError, ValueError):
        raise ValueError("transform must be a (4, 4) array of numbers") from None
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError(f"transform must be a (4, 4) array of finite numbers; its shape is {matrix.shape}")
    if not np.allclose(matrix[3], [0, 0, 0, 1]):
        raise ValueError(f"transform must have the last row 0 0 0 1, not {matrix[3]}")
    if not np.linalg.cond(matrix[:3, :3]) < 1e7:
        raise ValueError("transform is singular: it flattens the model")
    return matrix


def _check_material(material: Material | None) -> Material:
    material = Diffuse() if material is None else material
    if not isinstance(material, Material):
        raise ValueError(f"a material is a Diffuse or a Phong, not {type(material).__name__}")
    material.record()
    return material


def _check_rays(
    origins: ArrayLike, directions: ArrayLike, t_min: ArrayLike, t_max: ArrayLike
) -> tuple[tuple[int, ...], tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]]:
    """The leading shape, and rays as (n, 3), (n, 3), (n, 2) float64, C-contiguous and writable."""
    arrays = [_real(a, name) for a, name in ((origins, "origins"), (directions, "directions"))]
    limits = [_real(a, name) for a, name in ((t_min, "t_min"), (t_max, "t_max"))]
    for array, name in zip(arrays, ("origins", "directions"), strict=True):
        if array.ndim == 0 or array.shape[-1] != 3:
            raise ValueError(f"{name} must have the shape (..., 3), not {array.shape}")
    leading = [arrays[0].shape[:-1], arrays[1].shape[:-1], limits[0].shape, limits[1].shape]
    try:
        shape = np.broadcast_shapes(*leading)
    except ValueError:
        raise ValueError(f"origins, directions, t_min and t_max do not broadcast: leading shapes {leading}") from None
    o, d = (np.array(np.broadcast_to(a, (*shape, 3)), np.float64, order="C").reshape(-1, 3) for a in arrays)
    pair = np.stack([np.broadcast_to(a, shape).reshape(-1) for a in limits], axis=1).astype(np.float64)
    return shape, (o, d, np.ascontiguousarray(pair))


def _real(value: ArrayLike, name: str) -> NDArray[Any]:
    try:
        array = np.asarray(value)
    except ValueError:
        raise ValueError(f"{name} is no regular array of numbers") from None
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{name} must hold real numbers, not {array.dtype}")
    return array
