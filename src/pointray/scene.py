"""Scene: models and planes, each at its place, lights and a background; and rays cast at all of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .image.tone import srgb_to_linear
from .instances import Instance, Plane, check_material, check_transform, corners_of, record_of
from .model import Model
from .rays import Hits, check_rays
from .records import INSTANCE, KIND, MATERIAL, MODEL, MODEL_ROW, World, model_table
from .shade.lights import PointLight, SunLight, rgb
from .shade.materials import Material
from .trace.cast import blend_attribute, closest_hits, occlusions


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
        self._instances: dict[int, Instance] = {}
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
        material : Material, optional
            `Diffuse`, `Phong`, `Principled`, `Mirror`, `Dielectric` or `Emissive`; None: diffuse in the points' own
            colours.

        Returns
        -------
        int
            The number of this instance.
        """
        if not isinstance(shape, Model | Plane):
            raise ValueError(f"a scene holds Model and Plane, not {type(shape).__name__}")
        number = self._next
        self._instances[number] = Instance(shape, check_transform(transform), check_material(material))
        self._next += 1
        self._built = None
        return number

    def update(self, id: int, transform: ArrayLike | None = None, material: Material | None = None) -> None:
        """Move an instance, or give it another material; None leaves either as it is."""
        old = self._find(id)
        if transform is not None:
            old = replace(old, transform=check_transform(transform))
        if material is not None:
            old = replace(old, material=check_material(material))
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
        corners = [corners_of(i) for i in self._instances.values() if isinstance(i.shape, Model)]
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
        shape, rays = check_rays(origins, directions, t_min, t_max)
        world, numbers, _ = self._world()
        found = closest_hits(world, shape, *rays)
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
        shape, rays = check_rays(origins, directions, t_min, t_max)
        return occlusions(self._world()[0], shape, *rays).reshape(shape)

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

    def _find(self, id: int) -> Instance:
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
            records = [record_of(i, row) for i in self._instances.values()]
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
