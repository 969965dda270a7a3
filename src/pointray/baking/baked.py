"""Baked light, as `bake` returns it. The stages of a bake are in `exchange.py`."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_callback, check_kind, check_path, wrong
from ..base.arrays import Floats
from ..base.executor import Client, Executor, snapshot_and_executor
from ..base.progress import Progress, StageProgress, in_stage, report_progress
from ..base.registered import registered
from ..base.warning_log import warn
from ..cloud.conversion import PointsLike
from ..engine.jit import Array
from ..engine.kernels.records import World
from ..model.model import Model
from ..scene.scene import Scene
from ..scene.world import Snapshot
from . import store
from .budget import count_trees, describe_coarseness
from .exchange import Exchange
from .file import StoredLight, read_light, write_light
from .fingerprints import geometry_key, lacks_levels, light_key, scene_keys
from .lookup_tables import LightTables
from .planes import Grid
from .settings import BakeSettings
from .store import SplatLight
from .transport import ALL_SIDES

NO_LEVELS = "levels of detail were added after the bake: call update(), or bake again"


class StaleLightWarning(UserWarning):
    """Warning that a scene is rendered with baked light that no longer fits it, because something in it has changed.

    Examples
    --------
    >>> import warnings
    >>> warnings.simplefilter("error", pr.StaleLightWarning)  # an error instead of a warning
    """


class Baked:
    """Light that arrives at every splat and plane of a scene, as computed by `bake`.

    Assign it to `Scene.baked` to render with it: the integrator "baked" looks up light of the sky and of surfaces.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
    >>> light = scene.add_light(pr.SunLight((1, 1, -1.2)))
    >>> scene.baked = pr.bake(scene, pr.BakeSettings(links=8))
    >>> image = pr.render(scene, pr.frame(scene, size=(32, 24)), pr.Settings("baked"))
    >>> scene.baked.ambient_occlusion(ball).shape
    (1000,)
    """

    def __init__(self, scene: Scene, settings: BakeSettings, progress: Progress | None, client: Client = None) -> None:
        self._scene, self._settings = scene, settings
        if client is not None:
            scene = scene.copy()
            scene.baked = None  # not needed by the workers
        now, executor = snapshot_and_executor(scene, client)
        self._bake(now.without_camera_lights(), progress, executor)

    def _bake(self, snapshot: Snapshot, progress: Progress | None, executor: Executor | None = None) -> None:
        self._exchange = Exchange(snapshot.opened(), self._settings, progress, executor)
        self._shape = geometry_key(snapshot)
        self._write(snapshot)
        report_progress(progress, 1.0)

    def _write(self, snapshot: Snapshot) -> None:
        """Encode the light for rendering in records of 16 bytes per splat or cell of a plane, and keep them.

        Warn if no light arrives anywhere.
        """
        exchange, arrived = self._exchange, self._exchange.arrived
        if not arrived.direct.any() and not arrived.indirect.any():
            warn("the scene has no light: the baked light is black", stacklevel=5)
        unit, records = store.choose_unit(arrived), {}
        for (number, sign), side in exchange.sides.items():
            spread = exchange.spreads.get(number)
            for level in range(count_trees(side)) if spread is None else (0,):
                of = level if spread is None else spread
                records[number, sign, level] = store.make_records(side, of, arrived, unit, self._settings.threads)
        patches = {number: side.surface.patches for (number, _), side in exchange.sides.items()}
        grids = {number: grid for number, grid in patches.items() if isinstance(grid, Grid)}
        blocks = {number: spread.blocks for number, spread in exchange.spreads.items()}
        self._set_light(snapshot, light_key(snapshot), LightTables(unit, records, grids, blocks, exchange.levels))

    def _set_light(
        self, snapshot: Snapshot, lights: bytes, kept: LightTables, stored: StoredLight | None = None
    ) -> None:
        """Store the light with the scene that it belongs to, and reset the cached answer of whether it still fits.

        lights : hash of lights and materials, see `light_key`; kept : the light that rendering reads
        stored : contents of the file, for light from a file
        """
        self._baked_scene, self._lights = snapshot._replace(baked=None), lights
        self._kept, self._stored = kept, stored
        self._checked: World | None = None  # not the snapshot, which may refer to this object: a cycle
        self._reason: str | None = None
        self._warned: str | None = None

    @property
    def stale(self) -> str | None:
        """Reason why the light no longer fits the scene, as text that says what has changed; None if it fits."""
        return self._stale(self._scene.snapshot())

    def _stale(self, snapshot: Snapshot) -> str | None:
        if snapshot.world is self._checked:
            return self._reason
        fixed, reason = snapshot.without_camera_lights(), None
        shape = geometry_key(fixed)
        fewer = lacks_levels(self._shape, shape)
        if shape != self._shape and not fewer:
            reason = "models, planes or clip planes have changed: bake again"
        elif light_key(fixed) != self._lights:
            reason = "lights, materials or colours have changed: call update()"
        elif fewer:
            reason = NO_LEVELS
        self._checked, self._reason = snapshot.world, reason
        return reason

    def fits(self, scene: Scene) -> bool:
        """Return whether the light fits a scene: nothing that it depends on has changed since the bake.

        Parameters
        ----------
        scene : Scene
            The scene of the bake or a copy of it.

        Returns
        -------
        bool

        Examples
        --------
        >>> scene = pr.Scene()
        >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
        >>> light = scene.add_light(pr.SunLight((1, 1, -1.2)))
        >>> baked = pr.bake(scene, pr.BakeSettings(links=8))
        >>> baked.fits(scene)
        True
        """
        return self._stale(scene.snapshot()) is None

    def lacks_levels(self, scene: Scene) -> bool:
        """Return whether the light fits a scene, except that levels of detail added after the bake render black.

        Parameters
        ----------
        scene : Scene
            The scene of the bake or a copy of it.

        Returns
        -------
        bool

        Examples
        --------
        >>> scene = pr.Scene()
        >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
        >>> light = scene.add_light(pr.SunLight((1, 1, -1.2)))
        >>> baked = pr.bake(scene, pr.BakeSettings(links=8))
        >>> baked.lacks_levels(scene)
        False
        """
        return self._stale(scene.snapshot()) == NO_LEVELS

    def update(self, progress: StageProgress | None = None) -> None:
        """Bake again after a change of lights, sky, materials, colours or levels of detail.

        The links are reused: which surfaces and parts of the sky illuminate each patch of the scene. They are found
        again, which takes as long as `bake`, for light from a file, and if other sides of instances receive light now.

        Parameters
        ----------
        progress : callable, optional
            Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

        Raises
        ------
        TypeError
            If an argument has the wrong type.
        ValueError
            If models, planes or clip planes have changed, so that the links no longer fit.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
        >>> light = scene.add_light(pr.SunLight((1, 1, -1.2)))
        >>> baked = pr.bake(scene, pr.BakeSettings(links=8))
        >>> scene.lights = [pr.SunLight((-1, 1, -1.2))]
        >>> baked.update()
        >>> baked.stale is None
        True
        """
        check_callback(progress)
        report = in_stage(progress, "baking light")
        snapshot = self._scene.snapshot().without_camera_lights()
        shape = geometry_key(snapshot)
        if shape != self._shape and not lacks_levels(self._shape, shape):
            raise ValueError("the light does not fit: models, planes or clip planes have changed: bake again")
        if self._stored is not None:
            self._bake(snapshot, report)
            return
        self._exchange.relight(snapshot.opened(), shape != self._shape, report)
        self._shape = shape
        self._write(snapshot)
        report_progress(report, 1.0)

    def relit(self, scene: Scene) -> Baked | None:
        """Return the light of another scene with the same models, planes and clip planes.

        Lights, sky, materials and colours may differ. This object is not changed. Both share their links: which
        surfaces and parts of the sky illuminate each patch of the scene.

        Parameters
        ----------
        scene : Scene

        Returns
        -------
        Baked or None
            None if models, planes or clip planes differ.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
        >>> light = scene.add_light(pr.SunLight((1, 1, -1.2)))
        >>> baked = pr.bake(scene, pr.BakeSettings(links=8))
        >>> evening = scene.copy()
        >>> evening.lights = [pr.SunLight((1, 0, -0.1))]
        >>> evening.baked = baked.relit(evening)
        """
        shape = geometry_key(scene.snapshot().without_camera_lights())
        if shape != self._shape and not lacks_levels(self._shape, shape):
            return None
        twin = copy.copy(self)
        twin._scene = scene
        if self._stored is None:
            twin._exchange = copy.copy(self._exchange)
        twin.update()
        return twin

    def tables(self, scene: Snapshot, levels: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the arrays through which kernels read the light; warn once if the light no longer fits the scene.

        levels : (instances,), the level of detail that each instance shows

        Returns
        -------
        (instances * 5,) int64
            For each instance (address of the light records of its front, of its back, number of records of a side,
            address and length of the table that interpolates coarser light); valid while this array exists.
        (instances * 5,) float64
            For each instance the grid of a plane, and the unit of the stored irradiance, see `records.BAKED_FRAME`.
        """
        reason = self._stale(scene)
        if reason == NO_LEVELS and not levels.any():
            reason = None
        if reason is not None and reason != self._warned:
            warn(f"the baked light no longer fits the scene: {reason}", StaleLightWarning, stacklevel=6)
        self._warned = reason
        return self._kept.tables(scene, levels)

    def portable(self) -> LightTables:
        """Return the part of the light that rendering reads. It can be pickled, and does not detect stale light."""
        return self._kept

    def irradiance(self, id: int, side: int = 1) -> NDArray[np.float32]:
        """Return the irradiance at each point of an instance, direct and indirect.

        Parameters
        ----------
        id : int
            Number of an instance of a model, as returned by `Scene.add`.
        side : {1, -1}
            1 for the front, to which the normals point; -1 for the back.

        Returns
        -------
        (n, 3) float32
            In W/m2; NaN at points without a splat.

        Raises
        ------
        ValueError
            If `id` is not an instance of a model, or `side` is neither 1 nor -1.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
        >>> light = scene.add_light(pr.SunLight((1, 1, -1.2)))
        >>> baked = pr.bake(scene, pr.BakeSettings(links=8))
        >>> baked.irradiance(ball).shape
        (1000, 3)
        """
        return self._at_points(id, side, lambda at: at.direct + at.indirect)

    def indirect(self, id: int, side: int = 1) -> NDArray[np.float32]:
        """Return the irradiance from the sky and other surfaces, without that of lights, at each point of an instance.

        Parameters
        ----------
        id : int
            Number of an instance of a model, as returned by `Scene.add`.
        side : {1, -1}
            1 for the front, to which the normals point; -1 for the back.

        Returns
        -------
        (n, 3) float32
            In W/m2; NaN at points without a splat.

        Raises
        ------
        ValueError
            If `id` is not an instance of a model, or `side` is neither 1 nor -1.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
        >>> light = scene.add_light(pr.SunLight((1, 1, -1.2)))
        >>> baked = pr.bake(scene, pr.BakeSettings(links=8))
        >>> baked.indirect(ball).shape
        (1000, 3)
        """
        return self._at_points(id, side, lambda at: at.indirect)

    def ambient_occlusion(self, id: int) -> NDArray[np.float32]:
        """Return the cosine-weighted fraction of the sky visible from each point of an instance.

        Parameters
        ----------
        id : int
            Number of an instance of a model, as returned by `Scene.add`.

        Returns
        -------
        (n,) float32
            0 to 1; 1 if unobstructed, NaN at points without a splat.

        Raises
        ------
        ValueError
            If `id` is not an instance of a model.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
        >>> light = scene.add_light(pr.SunLight((1, 1, -1.2)))
        >>> baked = pr.bake(scene, pr.BakeSettings(links=8))
        >>> bool(np.allclose(baked.ambient_occlusion(ball), 1))
        True
        """
        return self._at_points(id, 1, lambda at: at.sky)

    def _at_points(self, id: int, sign: int, values_of: Callable[[SplatLight], Floats]) -> Floats:
        """Compute values from the light on one side of an instance, at its model's points, in their order.

        NaN at points without a splat; 0 on a back side that was not baked, being nearly dark.

        sign : 1 for the front, -1 for the back; values_of : computes (n, ...) values from the light at the model's n
            splats
        """
        if sign not in ALL_SIDES:
            raise wrong("side", "1 (front) or -1 (back)", sign)
        front = self._kept.records.get((id, 1, 0)) if isinstance(id, int | np.integer) else None
        model = self._scene.shapes.get(id)
        if isinstance(model, Model):
            model.check_whole()
        slots = self._kept.slots_of(id) if front is not None else 0
        if not isinstance(model, Model) or slots != len(model.tree.order):
            raise ValueError(f"no light is baked for id {id!r}: expected the id that `Scene.add` returned for a model")
        records = self._kept.records.get((id, sign, 0))
        if records is None:
            at = store.no_light(slots)
        elif self._stored is None:
            at = store.from_patches(self._exchange.sides[id, sign], self._exchange.arrived)
        else:
            blocks = self._kept.spreads.get(id, (None,))[0]
            at = store.from_records(records, self._kept.unit, self._stored.skies[id], blocks)
        return store.at_points(model, values_of(at))

    def save(self, path: str | os.PathLike[str], progress: StageProgress | None = None) -> None:
        """Write the light to a file, which `Baked.load` reads.

        It holds what rendering and exports need, but not the links between patches of the scene, which `update` reuses.

        Parameters
        ----------
        path : str or path
            Usually ends in .bake. An existing file is replaced once the new one is complete.
        progress : callable, optional
            Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

        Raises
        ------
        TypeError
            If an argument has the wrong type.
        OSError
            If the file cannot be written.
        ValueError
            If levels of detail were added after the bake.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
        >>> light = scene.add_light(pr.SunLight((1, 1, -1.2)))
        >>> baked = pr.bake(scene, pr.BakeSettings(links=8))
        >>> baked.save("sphere.bake")
        >>> pr.Baked.load("sphere.bake", scene).fits(scene)
        True
        """
        check_path(path)
        check_callback(progress)
        write_light(path, self._stored or self._store(), in_stage(progress, "writing") or (lambda share: None))

    def _store(self) -> StoredLight:
        """Return the light and hashes of the baked scene for a file; ValueError if levels of detail were added."""
        if geometry_key(self._baked_scene) != self._shape:
            raise ValueError("the light cannot be saved: levels of detail were added after the bake: bake again")
        skies = store.sky_visibility(self._exchange.sides, self._exchange.arrived, self._exchange.spreads)
        return StoredLight(self._settings, scene_keys(self._baked_scene), self._kept, skies)

    @classmethod
    def load(cls, path: str | os.PathLike[str], scene: Scene) -> Baked:
        """Map the light from a file written by `save`. Loading time does not depend on its size.

        Images are identical to those made with the light that was saved; `irradiance` and `indirect` are accurate to
        1/256 of the brightest channel. If lights, sky, materials or colours differ from those of the bake, `stale`
        says so. The file must not change while the light is used.

        Parameters
        ----------
        path : str or path
        scene : Scene
            Has the same models, planes and clip planes as the baked scene, with instances in the same order.

        Returns
        -------
        Baked

        Raises
        ------
        TypeError
            If an argument has the wrong type.
        OSError
            If the file cannot be opened.
        ValueError
            If the file is not baked light, is from another version, is damaged, or belongs to another scene.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
        >>> light = scene.add_light(pr.SunLight((1, 1, -1.2)))
        >>> baked = pr.bake(scene, pr.BakeSettings(links=8))
        >>> baked.save("sphere.bake")
        >>> scene.baked = pr.Baked.load("sphere.bake", scene)
        """
        check_path(path)
        check_kind(scene, "scene", Scene, "a Scene")
        snapshot = scene.snapshot().without_camera_lights()
        stored = read_light(path, snapshot)
        baked = cls.__new__(cls)
        baked._scene, baked._settings, baked._shape = scene, stored.settings, geometry_key(snapshot)
        lights = light_key(snapshot) if stored.keys.light == scene_keys(snapshot).light else b""
        baked._set_light(snapshot, lights, stored.kept, stored)
        return baked

    @property
    def nbytes(self) -> int:
        """Size in bytes of the light that rendering reads, in memory or in a mapped file."""
        return self._kept.nbytes

    @property
    def levels(self) -> dict[int, int]:
        """Coarseness of the light of each instance of a model, by instance number.

        Light is stored in records of 16 bytes. Level 0 has a record for each splat, level k one for every 4^(k - 1)
        patches, between which splats interpolate. Coarser light is used where records for all splats would not fit into
        `BakeSettings.memory`.
        """
        return dict(self._kept.levels)

    @property
    def coarser(self) -> str:
        """Text that says how many instances have less than one light record per splat; empty if none have."""
        return describe_coarseness(self._kept.levels)

    def __repr__(self) -> str:
        source = "from a file" if self._stored is not None else f"{len(self._exchange.transport):,} patches"
        ending = f", {self.coarser}" if self.coarser else ""
        return f"<Baked: {source}, {self.nbytes / 2**20:.0f} MiB{ending}>"


def bake(
    scene: Scene | PointsLike,
    settings: BakeSettings | None = None,
    progress: StageProgress | None = None,
    client: Client = None,
) -> Baked:
    """Bake the light of a scene: the light that arrives at every instance and plane, after all bounces.

    Parameters
    ----------
    scene : Scene, Model, or what `as_points` accepts, or a list of these
        Models, and those of points and paths of scans, stand in the fixed lights of `studio`; their instances are
        numbered from 0.
    settings : BakeSettings, optional
        Default: `BakeSettings()`.
    progress : callable, optional
        Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.
    client : dask.distributed.Client, optional
        Sends the rays on the workers of a cluster (`pip install 'pointray[cluster]'`). The light is the same, to the
        last bit if all processors are of one kind. `Baked.update` does not use the client.
        See https://pointray.readthedocs.io/page/scale.html.

    Returns
    -------
    Baked

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If the scene is empty, or `BakeSettings.memory` is too small even for the coarsest light.

    Notes
    -----
    Patches, a subset of the splats and cells of planes, send rays into the hemisphere. Each ray links its patch to
    the patch or part of the sky that it hits. Light bounces along these links until it converges (radiosity, Goral et
    al. 1984, with links as in Hanrahan, Salzman and Aupperle 1991, found by ray tracing). Mirrors and glass are
    followed; other surfaces reflect light like Lambertian ones of the same albedo.
    Lights attached to the camera are not baked. A back side that is nearly dark is treated as black.

    References
    ----------
    Goral, Torrance, Greenberg, Battaile: Modeling the interaction of light between diffuse surfaces (1984).
    Hanrahan, Salzman, Aupperle: A rapid hierarchical radiosity algorithm (1991).

    Examples
    --------
    >>> scene = pr.Scene()
    >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
    >>> light = scene.add_light(pr.SunLight((1, 1, -1.2)))
    >>> baked = pr.bake(scene, pr.BakeSettings(links=8))
    >>> baked.irradiance(ball).shape
    (1000, 3)
    """
    settings = BakeSettings() if settings is None else check_kind(settings, "settings", BakeSettings, "BakeSettings")
    check_callback(progress)
    if not isinstance(scene, Scene):
        return registered("default_scene").baked(scene, settings, progress, client)
    if not scene.shapes:
        raise ValueError("the scene is empty: nothing to bake")
    return Baked(scene, settings, in_stage(progress, "baking light"), client)
