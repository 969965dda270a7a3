"""Instances: a model or a plane at its place, with its material; and the record that kernels read of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .model import Model
from .records import (
    INSTANCE,
    KIND,
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
)
from .shade.lights import rgb, vector
from .shade.materials import Diffuse, Material


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
class Instance:
    """One thing in a scene."""

    shape: Model | Plane
    transform: NDArray[np.float64]
    material: Material


def record_of(instance: Instance, row: dict[int, int]) -> NDArray[np.float64]:
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


def corners_of(instance: Instance) -> NDArray[np.float64]:
    """World positions of the corners of a model's bounds, (8, 3)."""
    assert isinstance(instance.shape, Model)
    low, high = instance.shape.bounds
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
    return np.asarray(corners @ instance.transform[:3, :3].T + instance.transform[:3, 3])


def check_transform(transform: ArrayLike | None) -> NDArray[np.float64]:
    """A transform as (4, 4) float64; None: the identity."""
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


def check_material(material: Material | None) -> Material:
    """A material whose record can be made; None: diffuse."""
    material = Diffuse() if material is None else material
    if not isinstance(material, Material):
        kinds = ", ".join(sorted(kind.__name__ for kind in Material.__subclasses__()))
        raise ValueError(f"a material is one of {kinds}, not {type(material).__name__}")
    material.record()
    return material
