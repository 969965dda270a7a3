"""Scene: models and planes with transforms, lights and a background, and ray queries on it."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.arguments import check_flag, check_kind, check_mapping, rgb, wrong
from ..base.executor import backend, is_chunked
from ..model.model import Model
from ..shade.attributes import Attribute
from ..shade.environment import EnvironmentLight, Lights
from ..shade.lights import Light
from ..shade.materials.base import Material
from .casting import RayArguments, intersect_snapshot, occluded_snapshot
from .clips import check_clips, clip_records
from .instances import Instances, Plane, check_material, check_transform
from .rays import Hits, check_rays
from .world import BakedLight, Snapshot, bounds_of, take_snapshot


class Scene:
    """Scene of models and planes, lights, clip planes and a background.

    A scene is thread-safe: each call uses the scene as it was when the call began. Copies by `copy` and `copy.copy`
    share the models; `copy.deepcopy` and `pickle` copy them.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)), material=pr.Phong(specular=0.05))
    >>> light = scene.add_light(pr.SunLight((1, 1, -1.2)))
    >>> image = pr.render(scene, pr.frame(scene, size=(32, 24)))
    >>> hits = scene.intersect([0, -5, 0], [0, 1, 0])
    >>> round(float(hits.t), 2)
    4.0
    """

    def __init__(self) -> None:
        self._instances = Instances()
        self._lights = Lights()
        self._background: NDArray[np.float64] | None = None
        self._clips = check_clips(())
        self._version = 0  # increases with every change
        self.shows_sky = False
        self._baked: BakedLight | None = None
        self._built: Snapshot | None = None
        self._lock = threading.RLock()  # held during changes, and while several fields are read

    def add(self, shape: Model | Plane, transform: ArrayLike | None = None, material: Material | None = None) -> int:
        """Add an instance of a model or a plane to the scene.

        Parameters
        ----------
        shape : Model or Plane
        transform : (4, 4) array_like, optional
            From model to world space, for column vectors: any affine transform that is not singular.
        material : Material, optional
            `Diffuse`, `Phong`, `Principled`, `Mirror`, `Dielectric` or `Emissive`; None: `Diffuse` in the points'
            colours. If it shows an `Attribute`, the model must have that attribute.

        Returns
        -------
        int
            Number of the instance, for `update` and `remove`.

        Raises
        ------
        TypeError
            If an argument has the wrong type.
        ValueError
            If the transform is singular or not affine, or the model lacks the attribute of the material.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> model = pr.Model(pr.procedural("sphere", 1000))
        >>> scene.add(model), scene.add(model, pr.transform(translate=(3, 0, 0)), pr.Mirror())
        (0, 1)
        """
        check_kind(shape, "shape", (Model, Plane), "a Model or a Plane")
        matrix, checked = check_transform(transform), check_material(material, shape)
        with self._lock:
            self._change()
            return self._instances.add(shape, matrix, checked)

    def update(self, id: int, transform: ArrayLike | None = None, material: Material | None = None) -> None:
        """Set the transform or the material of an instance.

        Parameters
        ----------
        id : int
            Number that `add` returned.
        transform : (4, 4) array_like, optional
            New transform from model to world space, for column vectors; None: unchanged.
        material : Material, optional
            New material; None: unchanged.

        Raises
        ------
        TypeError
            If an argument has the wrong type.
        ValueError
            If there is no such instance, the transform is singular or not affine, or the model lacks the attribute of
            the material.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
        >>> scene.update(ball, pr.transform(translate=(0, 0, 10)), pr.Mirror())
        >>> bool(scene.bounds[0, 2] > 8)
        True
        """
        matrix = None if transform is None else check_transform(transform)
        with self._lock:
            row = self._instances.row_of(id)
            checked = None if material is None else check_material(material, self._instances.shapes[row])
            self._change()
            if checked is not None:
                self._instances.paint(row, checked)
            if matrix is not None:
                self._instances.move(row, matrix)

    def remove(self, id: int) -> None:
        """Remove an instance. The numbers of the others do not change.

        Parameters
        ----------
        id : int
            Number that `add` returned.

        Raises
        ------
        TypeError
            If an argument has the wrong type.
        ValueError
            If there is no such instance.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
        >>> scene.remove(ball)
        >>> scene.shapes
        {}
        """
        with self._lock:
            row = self._instances.row_of(id)
            self._change()
            self._instances.remove(row)

    def add_light(self, light: Light | EnvironmentLight) -> int:
        """Add a light. Without any, the camera has a headlight.

        Parameters
        ----------
        light : PointLight, SunLight, RectLight, DiskLight, SphereLight or EnvironmentLight
            At most one `EnvironmentLight`.

        Returns
        -------
        int
            Index of the light in `lights`.

        Raises
        ------
        TypeError
            If an argument has the wrong type.
        ValueError
            If the scene has an `EnvironmentLight` already and this is another one.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> scene.add_light(pr.SunLight((1, 1, -1.2))), scene.add_light(pr.EnvironmentLight(0.3))
        (0, 1)
        """
        with self._lock:
            lights = self._lights.plus(light)
            self._change()
            self._lights = lights
            return len(lights) - 1

    @property
    def lights(self) -> tuple[Light | EnvironmentLight, ...]:
        """All lights in the order of addition. Assignment replaces them.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> scene.lights = pr.studio()
        >>> len(scene.lights)
        3
        """
        return tuple(self._lights)

    @lights.setter
    def lights(self, lights: Iterable[Light | EnvironmentLight]) -> None:
        checked = Lights(check_kind(lights, "lights", Iterable, "a sequence of lights"))
        with self._lock:
            self._change()
            self._lights = checked

    @property
    def background(self) -> NDArray[np.float64] | None:
        """Linear RGB of the background, or None if transparent. Set to "environment" to show the environment light."""
        return self._background

    @background.setter
    def background(self, color: ArrayLike | None) -> None:
        shows_sky = isinstance(color, str) and color == "environment"
        background = None if color is None or shows_sky else rgb(color, "background")
        with self._lock:
            self._background, self.shows_sky = background, shows_sky
            self._version += 1
            if self._built is not None:
                self._built = self._built._replace(background=background, shows_sky=shows_sky)

    @property
    def clips(self) -> NDArray[np.float64]:
        """Clip planes: rays hit nothing on the side that a plane's normal points to.

        Clipped geometry is invisible and casts no shadow, in pictures and for `intersect` and `occluded`. Cuts are not
        capped. Lights are not clipped, and `bounds` ignores clip planes.

        Parameters
        ----------
        clips : sequence of (point, normal), or (k, 6) array_like
            At most 16 planes in world space, each a point and a normal of any length. () clips nothing.

        Returns
        -------
        (k, 2, 3) float64
            Point and normal of each plane, read-only.

        Raises
        ------
        ValueError
            If there are too many planes, the shape is wrong, a number is not finite or a normal is zero.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> scene.clips = [((0, 0, 1.5), (0, 0, 1))]  # removes everything above z = 1.5
        >>> scene.clips.shape
        (1, 2, 3)
        """
        return self._clips

    @clips.setter
    def clips(self, clips: ArrayLike | Sequence[tuple[ArrayLike, ArrayLike]]) -> None:
        checked = check_clips(clips)
        with self._lock:
            self._clips = checked
            self._version += 1
            if self._built is not None:  # only the clip planes are replaced: a viewer moves them every frame
                self._built = self._built._replace(world=self._built.world._replace(clips=clip_records(checked)))

    @property
    def baked(self) -> BakedLight | None:
        """Light shown by the integrator "baked", as returned by `bake`; None: each call of `render` bakes its own."""
        return self._baked

    @baked.setter
    def baked(self, baked: BakedLight | None) -> None:
        if baked is not None and not callable(getattr(baked, "tables", None)):
            raise wrong("baked", "what `bake` returned, or None", baked)
        with self._lock:
            self._baked = baked
            self._version += 1
            if self._built is not None:
                self._built = self._built._replace(baked=baked)

    @property
    def shapes(self) -> dict[int, Model | Plane]:
        """The shape of each instance, by the number that `add` returned."""
        with self._lock:
            return dict(zip(self._instances.numbers.tolist(), self._instances.shapes, strict=True))

    @property
    def models(self) -> list[Model]:
        """The distinct models, in the order of addition."""
        with self._lock:
            return list(dict.fromkeys(shape for shape in self._instances.shapes if isinstance(shape, Model)))

    def exchange(self, models: Mapping[Model, Model]) -> Scene:
        """Return a copy in which models are replaced by others of the same points.

        Parameters
        ----------
        models : dict of Model to Model
            The new model of each model to replace. Models that the scene does not contain are ignored.

        Returns
        -------
        Scene

        Raises
        ------
        TypeError
            If an argument has the wrong type.

        Examples
        --------
        >>> model = pr.Model(pr.procedural("sphere", 1000))
        >>> scene = pr.Scene()
        >>> ball = scene.add(model)
        >>> flat = scene.exchange({model: model.rebuild("auto", surface="disc")})
        >>> flat.shapes[ball].surface
        'disc'
        """
        twin = self.copy()
        for pair in check_mapping(models, "models").items():
            if not all(isinstance(model, Model) for model in pair):
                raise wrong("models", "a dict of models", models)
        twin._change()
        twin._instances.exchange(models)
        return twin

    def copy(self) -> Scene:
        """Copy the scene.

        Returns
        -------
        Scene
            An independent scene that shares models, materials, lights and the numbers of instances.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> light = scene.copy().add_light(pr.SunLight((1, 1, -1.2)))
        >>> scene.lights
        ()
        """
        twin = object.__new__(type(self))
        with self._lock:
            twin.__dict__.update(self.__dict__)
            twin._instances = self._instances.copy()
        twin._lock = threading.RLock()
        return twin

    __copy__ = copy

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for `pickle` and `copy.deepcopy`, without baked light and the cached snapshot."""
        twin = self.copy()
        twin._baked = None
        return {name: value for name, value in twin.__dict__.items() if name not in ("_built", "_lock")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._built, self._lock = None, threading.RLock()

    @property
    def bounds(self) -> NDArray[np.float64]:
        """World bounds of all models, minimum and maximum, (2, 3) float64; ValueError without models."""
        with self._lock:
            return bounds_of(self._instances.records, self._instances.boxes)

    @property
    def shown_attributes(self) -> list[Attribute]:
        """The distinct attributes that colour instances, with the ranges that are shown, for a legend."""
        return list(self.snapshot().shown)

    def intersect(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_min: ArrayLike = 0,
        t_max: ArrayLike = np.inf,
        *,
        attributes: str | tuple[str, ...] | list[str] = (),
        spread: bool = False,
    ) -> Hits:
        """Return the closest hit of each ray.

        A ray that starts on a surface (at t_min, within 1% of a support radius, 5% if the model's `refine` is 0) starts
        outside of it: the surface around its origin blocks it only if it goes inwards, against the normal. Otherwise
        t_min and t_max only select among the hits of a ray: a shorter ray hits what the whole ray hits, or nothing.

        Rays in Dask arrays are intersected when the hits are computed, one task per chunk, with the scene as it was at
        the call. `dask.compute(hits)` computes all fields at once.
        See https://pointray.readthedocs.io/page/scale.html.

        Parameters
        ----------
        origins, directions : (..., 3) array_like
            In world space; broadcast with t_min and t_max. A direction may have any length; rays with a direction that
            is zero or not finite miss.
        t_min, t_max : (...) array_like
            Range of valid hits, in lengths of the direction.
        attributes : str or sequence of str
            Names of the points' attributes to blend at the hits. Categories (bools, at most 32 different integers,
            classes) are not blended: a hit has the value of the splat of greatest weight. See `Hits.attributes` for the
            dtypes.
        spread : bool
            Only for Dask arrays with a client: whether each worker opens only some parts of models in parts. Each
            chunk is sent to all workers, and the nearest hits are merged.

        Returns
        -------
        Hits
            Dask arrays if any argument is one, with the same chunks except along the last axis.

        Raises
        ------
        ValueError
            If shapes do not broadcast, a dtype is not numeric, no model has an attribute of that name, a Dask array
            has chunks of unknown size, or parts cannot be spread.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
        >>> hits = scene.intersect([[0, -5, 0], [0, -5, 3]], [0, 1, 0])
        >>> hits.t.round(2).tolist()
        [4.0, inf]
        """
        given = origins, directions, t_min, t_max
        names = (attributes,) if isinstance(attributes, str) else attributes
        if not isinstance(names, tuple | list) or not all(isinstance(name, str) for name in names):
            raise wrong("attributes", "a name or a sequence of names", attributes)
        if _is_chunked(given, spread):
            return backend().intersect_chunks(self, given, names, spread)
        return intersect_snapshot(self.snapshot(), *check_rays(*given), names)

    def occluded(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_min: ArrayLike = 0,
        t_max: ArrayLike = np.inf,
        *,
        spread: bool = False,
    ) -> NDArray[np.bool_]:
        """Return whether each ray hits anything between t_min and t_max.

        Parameters
        ----------
        origins, directions : (..., 3) array_like
            In world space; broadcast with t_min and t_max. A direction may have any length; rays with a direction that
            is zero or not finite miss.
        t_min, t_max : (...) array_like
            Range in which hits count, in lengths of the direction.
        spread : bool
            Only for Dask arrays with a client: whether each worker opens only some parts of models in parts.

        Returns
        -------
        (...) bool
            A Dask array if any argument is one.

        Raises
        ------
        ValueError
            If shapes do not broadcast, a dtype is not numeric, a Dask array has chunks of unknown size, or parts cannot
            be spread.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
        >>> scene.occluded([[0, -5, 0], [0, -5, 3]], [0, 1, 0]).tolist()
        [True, False]
        """
        given = origins, directions, t_min, t_max
        if _is_chunked(given, spread):
            return backend().occluded_chunks(self, given, spread)
        return occluded_snapshot(self.snapshot(), *check_rays(*given))

    def _change(self) -> None:
        """Prepare for a change of instances or lights: discard the cached snapshot; copy the arrays it shares."""
        self._version += 1
        if self._built is not None:
            self._instances.detach()
        self._built = None

    def snapshot(self) -> Snapshot:
        """Return the current scene as a snapshot, the same object until the scene changes."""
        with self._lock:
            if self._built is None:
                self._built = take_snapshot(
                    self._instances, self._lights, self._clips, self._background, self.shows_sky, self._baked
                )
            return self._built


def _is_chunked(given: RayArguments, spread: bool) -> bool:
    """Return whether any of the rays' arrays is a Dask array; ValueError if none is although `spread` is set.

    given : origins, directions, t_min, t_max; spread : whether each worker opens only some parts of models
    """
    chunked = is_chunked(*given)
    if check_flag(spread, "spread") and not chunked:
        raise ValueError("spread: requires rays in Dask arrays")
    return chunked
