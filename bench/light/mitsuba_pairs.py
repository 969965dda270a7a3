"""Lights and materials, each described once for pointray and once for Mitsuba 3.

z is up. Materials that Mitsuba lacks are in `mitsuba_formulas.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pointray as pr
from pointray.shade.lights import Light
from pointray.shade.materials.base import Material

Floats = NDArray[np.float64]

ROWS = 256  # size of a picture of the sky
COLOR, METAL = (0.7, 0.5, 0.3), (0.9, 0.7, 0.3)
TO_SPOT = np.array([0.45, -0.6, 0.66])
FLAT = np.array([(0.8, 0.6, 0.0), (0.576, -0.768, -0.28)])  # the sides of flat lights, which face their cross product

# ------------------------------------------------------------------------------------------------------------- lights


class LightPair(NamedTuple):
    """The same light for both. hard : whether its shadows have sharp edges"""

    ours: Light | pr.EnvironmentLight
    theirs: dict[str, Any]
    hard: bool = False


def rgb(color: Any) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(c) for c in np.broadcast_to(color, 3)]}


def placed(x: Any, y: Any, z: Any, origin: Any) -> Any:
    """Mitsuba's transform that takes the axes to x, y, z and zero to `origin`."""
    import mitsuba as mi

    matrix = np.eye(4)
    matrix[:3] = np.stack([x, y, z, origin], axis=1)
    return mi.ScalarTransform4f(matrix)


def _shining(kind: str, to_world: Any, radiance: float) -> dict[str, Any]:
    """A shape that emits and, like our lights, reflects nothing."""
    black = {"type": "diffuse", "reflectance": rgb(0.0)}
    return {"type": kind, "to_world": to_world, "bsdf": black, "emitter": {"type": "area", "radiance": rgb(radiance)}}


def _sky_picture(radiance: Callable[[Floats], Floats]) -> LightPair:
    """A picture of the sky, as a function of directions (..., 3).

    Our pixels and Mitsuba's agree from left to right, but its first and last rows are the poles themselves.
    """
    import mitsuba as mi

    def picture(polar: Floats) -> NDArray[np.float32]:
        around = ((np.arange(2 * ROWS) + 0.5) / (2 * ROWS) - 0.5) * 2 * np.pi
        flat = np.stack([np.sin(around), np.cos(around)], axis=1)
        d = np.empty((ROWS, 2 * ROWS, 3))
        d[..., :2] = np.sin(polar)[:, None, None] * flat
        d[..., 2] = np.cos(polar)[:, None]
        return radiance(d).astype(np.float32)

    theirs = mi.Bitmap(np.ascontiguousarray(picture(np.linspace(0.0, np.pi, ROWS))))
    # Mitsuba's sky looks along z with y up and x to the left.
    turned = placed((-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.0))
    return LightPair(
        pr.EnvironmentLight(image=picture((np.arange(ROWS) + 0.5) / ROWS * np.pi)),
        {"type": "envmap", "bitmap": theirs, "to_world": turned},
    )


def _gradient(d: Floats) -> Floats:
    """A sky from brown below to blue above, brighter to the right."""
    up, side = 0.5 + 0.5 * d[..., 2:], 1.0 + 0.5 * d[..., :1]
    return np.asarray(side * (up * (0.5, 0.8, 1.2) + (1.0 - up) * (0.5, 0.4, 0.3)))


def _spot(d: Floats) -> Floats:
    """A dim gradient with a bright disc of some 5 degrees."""
    along = d @ (TO_SPOT / np.linalg.norm(TO_SPOT))
    return np.asarray(0.2 * _gradient(d) + 60.0 * np.exp((along[..., None] - 1.0) / 0.004))


def _point() -> LightPair:
    position, intensity = [4.0, -6.0, 8.0], 300.0
    theirs = {"type": "point", "position": position, "intensity": rgb(intensity)}
    return LightPair(pr.PointLight(position, intensity), theirs, hard=True)


def _sun() -> LightPair:
    direction = [-0.4, 0.6, -0.7]
    theirs = {"type": "directional", "direction": direction, "irradiance": rgb(3.0)}
    return LightPair(pr.SunLight(direction, 3.0, angle=0.0), theirs, hard=True)


def _constant() -> LightPair:
    radiance = (1.0, 0.9, 0.7)
    return LightPair(pr.EnvironmentLight(radiance), {"type": "constant", "radiance": rgb(radiance)})


def _flat(kind: str) -> LightPair:
    """A rectangle or a disk above and in front of the model. Its back, which only Mitsuba has, must not be visible."""
    u, v = FLAT
    facing = np.cross(u, v)
    center = -10.0 * facing
    if kind == "rectangle":
        ours: Light = pr.RectLight(center, 3.0 * u, 2.0 * v, 6.0)
        return LightPair(ours, _shining(kind, placed(3.0 * u, 2.0 * v, facing, center), 6.0))
    ours = pr.DiskLight(center, facing, 2.0, 12.0)
    return LightPair(ours, _shining(kind, placed(2.0 * u, 2.0 * v, facing, center), 12.0))


def _sphere() -> LightPair:
    center, radius = [3.0, -4.0, 8.5], 1.2
    theirs = _shining("sphere", placed(*(radius * np.eye(3)), center), 30.0)
    return LightPair(pr.SphereLight(center, radius, 30.0), theirs)


LIGHTS: dict[str, Callable[[], LightPair]] = {
    "point": _point,
    "sun": _sun,
    "constant": _constant,
    "gradient": lambda: _sky_picture(_gradient),
    "spot": lambda: _sky_picture(_spot),
    "rectangle": lambda: _flat("rectangle"),
    "disk": lambda: _flat("disk"),
    "sphere": _sphere,
}

# ---------------------------------------------------------------------------------------------------------- materials


class MaterialPair(NamedTuple):
    """The same material for both. bounces : how many are needed to see the scene in it"""

    ours: Material
    theirs: dict[str, Any]
    bounces: int = 1


def diffuse(color: Any) -> dict[str, Any]:
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(color)}}


def _metal(color: Any, roughness: float) -> dict[str, Any]:
    """Disney's metal: like ours GGX with alpha = roughness^2 and Schlick's Fresnel, but with uncorrelated masking."""
    metal = {"type": "principled", "base_color": rgb(color), "roughness": roughness, "metallic": 1.0}
    return {"type": "twosided", "bsdf": metal}


def _white_metal(roughness: float) -> dict[str, Any]:
    """A conductor that reflects everything, like ours: Schlick's Fresnel of 1 is 1 at every angle."""
    metal = {"type": "roughconductor", "material": "none", "alpha": roughness**2, "distribution": "ggx"}
    return {"type": "twosided", "bsdf": metal}


def _formula(kind: str, **values: Any) -> dict[str, Any]:
    return {"type": "twosided", "bsdf": {"type": kind, **values}}


MATERIALS: dict[str, Callable[[], MaterialPair]] = {
    "diffuse": lambda: MaterialPair(pr.Diffuse(COLOR), diffuse(COLOR)),
    "phong": lambda: MaterialPair(
        pr.Phong(COLOR, 0.3, 30.0), _formula("pointray_phong", color=rgb(COLOR), specular=0.3, exponent=30.0)
    ),
    "metal": lambda: MaterialPair(pr.Principled(METAL, 0.4, 1.0), _metal(METAL, 0.4)),
    "white metal": lambda: MaterialPair(pr.Principled(1.0, 0.4, 1.0), _white_metal(0.4)),
    "plastic": lambda: MaterialPair(
        pr.Principled(COLOR, 0.4, 0.0), _formula("pointray_plastic", color=rgb(COLOR), roughness=0.4)
    ),
    "mirror": lambda: MaterialPair(
        pr.Mirror(), {"type": "twosided", "bsdf": {"type": "conductor", "material": "none"}}, 4
    ),
    "glass": lambda: MaterialPair(pr.Dielectric(1.5), {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}, 8),
}

FORMULAS = ("phong", "plastic")  # materials that are defined for Mitsuba here
