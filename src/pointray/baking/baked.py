"""Baked light: what `bake` returns. It is made in `exchange.py`."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_callback, check_kind, check_path, wrong
from ..base.executor import Client, Executor, snapshot_and_executor
from ..base.progress import Progress, tell
from ..base.warning_log import warn
from ..engine.jit import Array
from ..engine.kernels.records import World
from ..model.model import Model
from ..scene.scene import Scene
from ..scene.world import Snapshot
from .budget import coarseness, levels_of
from .exchange import Exchange
from .file import Stored, read_light, write_light
from .fingerprints import keys_of, lacks_levels, lights_of, shape_of
from .lookup_tables import Kept
from .planes import Grid
from .settings import BakeSettings
from .store import AtSplats, at_points, dark, from_patches, from_records, make_records, seen_skies, unit_of
from .transport import ALL_SIDES

NO_LEVELS = "levels of detail were made after the bake: call update(), or bake again"

Floats = NDArray[np.float32]


class StaleLightWarning(UserWarning):
    """Baked light no longer fits its scene, see `Baked.stale`."""


class Baked:
    """The light that arrives at every splat and plane of a scene; `bake` makes it.

    Examples
    --------
    >>> scene.baked = pr.bake(scene)
    >>> picture = pr.render(scene, camera, pr.Settings("baked", spp=16))
    >>> shade = scene.baked.ambient_occlusion(statue)
    """

    def __init__(self, scene: Scene, settings: BakeSettings, progress: Progress | None, client: Client = None) -> None:
        self._scene, self._settings = scene, settings
        if client is not None:
            scene = scene.copy()
            scene.baked = None  # it is not sent
        now, executor = snapshot_and_executor(scene, client)
        self._bake(now.without_camera_lights(), progress, executor)

    def _bake(self, snapshot: Snapshot, progress: Progress | None, executor: Executor | None = None) -> None:
        self._exchange = Exchange(snapshot.opened(), self._settings, progress, executor)
        self._shape = shape_of(snapshot)
        self._write(snapshot)
        tell(progress, 1.0)

    def _write(self, snapshot: Snapshot) -> None:
        """Write the records of the light that arrives."""
        exchange, arrived = self._exchange, self._exchange.arrived
        if not arrived.direct.any() and not arrived.indirect.any():
            warn("the scene has no light: what is baked is black", stacklevel=5)
        unit, records = unit_of(arrived), {}
        for (number, sign), side in exchange.sides.items():
            spread = exchange.spreads.get(number)
            for level in range(levels_of(side)) if spread is None else (0,):
                of = level if spread is None else spread
                records[number, sign, level] = make_records(side, of, arrived, unit, self._settings.threads)
        patches = {number: side.sheet.patches for (number, _), side in exchange.sides.items()}
        grids = {number: grid for number, grid in patches.items() if isinstance(grid, Grid)}
        blocks = {number: spread.blocks for number, spread in exchange.spreads.items()}
        self._begin(snapshot, lights_of(snapshot), Kept(unit, records, grids, blocks, exchange.levels))

    def _begin(self, snapshot: Snapshot, lights: bytes, kept: Kept, stored: Stored | None = None) -> None:
        """Keep light, the scene that it is of, and the file's contents if it is from one."""
        self._baked_of, self._lights = snapshot._replace(baked=None), lights
        self._kept, self._stored = kept, stored
        self._checked: World | None = None  # of a snapshot, which may hold this light: that would be a cycle
        self._reason: str | None = None
        self._warned: str | None = None

    @property
    def stale(self) -> str | None:
        """Why the light no longer fits the scene; None: it does."""
        return self._stale(self._scene.snapshot())

    def _stale(self, snapshot: Snapshot) -> str | None:
        if snapshot.world is self._checked:
            return self._reason
        fixed, reason = snapshot.without_camera_lights(), None
        shape = shape_of(fixed)
        fewer = lacks_levels(self._shape, shape)
        if shape != self._shape and not fewer:
            reason = "models, planes or clip planes have changed: bake again"
        elif lights_of(fixed) != self._lights:
            reason = "lights, materials or colours have changed: call update()"
        elif fewer:
            reason = NO_LEVELS
        self._checked, self._reason = snapshot.world, reason
        return reason

    def fits(self, scene: Scene) -> bool:
        """Whether the light is that of a scene, which may be a copy of its own."""
        return self._stale(scene.snapshot()) is None

    def lacks_levels(self, scene: Scene) -> bool:
        """Whether it is the light of a scene but for levels of detail, which were made later: they are dark."""
        return self._stale(scene.snapshot()) == NO_LEVELS

    def update(self, progress: Progress | None = None) -> None:
        """Bake anew, without new links, for other lights, another sky, other materials and colours, levels of detail.

        Light from a file has no links: they are found anew, as in `bake`, which takes as long.

        Raises
        ------
        ValueError
            If models, planes or clip planes have changed: links no longer fit.
        """
        check_callback(progress)
        snapshot = self._scene.snapshot().without_camera_lights()
        shape = shape_of(snapshot)
        if shape != self._shape and not lacks_levels(self._shape, shape):
            raise ValueError("the light does not fit: models, planes or clip planes have changed: bake again")
        if self._stored is not None:
            self._bake(snapshot, progress)
            return
        self._exchange.follow(snapshot.opened(), shape != self._shape, progress)
        self._shape = shape
        self._write(snapshot)
        tell(progress, 1.0)

    def relit(self, scene: Scene) -> Baked | None:
        """The light of another scene with the same models, planes and clip planes; None if these differ.

        This one stays as it is. Both share their links.
        """
        shape = shape_of(scene.snapshot().without_camera_lights())
        if shape != self._shape and not lacks_levels(self._shape, shape):
            return None
        twin = copy.copy(self)
        twin._scene = scene
        if self._stored is None:
            twin._exchange = copy.copy(self._exchange)
        twin.update()
        return twin

    def tables(self, scene: Snapshot, levels: NDArray[np.int64]) -> tuple[Array, Array]:
        """What kernels read, see `records.BAKED`. levels : (instances,), which level of its model each shows

        A warning tells once if the light is stale.
        """
        reason = self._stale(scene)
        if reason == NO_LEVELS and not levels.any():
            reason = None
        if reason is not None and reason != self._warned:
            warn(f"the baked light no longer fits the scene: {reason}", StaleLightWarning, stacklevel=6)
        self._warned = reason
        return self._kept.tables(scene, levels)

    def portable(self) -> Kept:
        """What pictures read of it, which can be pickled; it does not know whether it is stale."""
        return self._kept

    def irradiance(self, id: int, side: int = 1) -> Floats:
        """All light that arrives at each point of an instance on one side, (n, 3), in W/m2 of the lights' units.

        side : 1, the front, where normals point; -1, the back
        NaN at points that have no splat. ValueError if `id` is no instance of a model.
        """
        return self._at_points(id, side, lambda at: at.direct + at.indirect)

    def indirect(self, id: int, side: int = 1) -> Floats:
        """The same without the direct light of lights: from the sky and from other surfaces."""
        return self._at_points(id, side, lambda at: at.indirect)

    def ambient_occlusion(self, id: int) -> Floats:
        """The share of the sky that each point sees, weighted by the cosine, (n,): 1 where nothing is in the way."""
        return self._at_points(id, 1, lambda at: at.sky)

    def _at_points(self, id: int, sign: int, values_of: Callable[[AtSplats], Floats]) -> Floats:
        """What arrives at the points of an instance's model, in the model's order; 0 on a dark back."""
        if sign not in ALL_SIDES:
            raise wrong("side", "1, the front, or -1, the back", sign)
        front = self._kept.records.get((id, 1, 0)) if isinstance(id, int | np.integer) else None
        model = self._scene.shapes.get(id)
        if isinstance(model, Model):
            model.check_whole()
        slots = self._kept.slots_of(id) if front is not None else 0
        if not isinstance(model, Model) or slots != len(model.tree.order):
            raise ValueError(f"no light is baked for a model {id!r}: id is what `Scene.add` returned for one")
        records = self._kept.records.get((id, sign, 0))
        if records is None:
            at = dark(slots)
        elif self._stored is None:
            at = from_patches(self._exchange.sides[id, sign], self._exchange.arrived)
        else:
            blocks = self._kept.spreads.get(id, (None,))[0]
            at = from_records(records, self._kept.unit, self._stored.skies[id], blocks)
        return at_points(model, values_of(at))

    def save(self, path: str | os.PathLike[str], progress: Progress | None = None) -> None:
        """Write the light to a file that `load` maps: what pictures and exports need, and not the links.

        Parameters
        ----------
        path : str or path
            Usually ends in .bake; the file is replaced when all is written.
        progress : callable, optional
            Called with the share done.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        check_path(path)
        check_callback(progress)
        write_light(path, self._stored or self._store(), progress or (lambda share: None))

    def _store(self) -> Stored:
        """What a file holds."""
        if shape_of(self._baked_of) != self._shape:
            raise ValueError("the light cannot be saved: levels of detail were made after the bake: bake again")
        skies = seen_skies(self._exchange.sides, self._exchange.arrived, self._exchange.spreads)
        return Stored(self._settings, keys_of(self._baked_of), self._kept, skies)

    @classmethod
    def load(cls, path: str | os.PathLike[str], scene: Scene) -> Baked:
        """The light that `save` has written, mapped into memory: it is ready at once, whatever its size.

        Pictures are those of the light that was saved, to the last bit; `irradiance` and `indirect` are as exact as
        pictures: to a 256th of the brightest channel. If lights, sky, materials or colours are no longer those of the
        bake, `stale` says so. The file must not change while the light is used.

        Parameters
        ----------
        scene : Scene
            Of the same models, planes and clip planes as when it was baked, instances in the same order.

        Raises
        ------
        OSError
            If the file cannot be opened.
        ValueError
            If it is no baked light, has another version, is damaged, or is of another scene.
        """
        check_path(path)
        check_kind(scene, "scene", Scene, "a Scene")
        snapshot = scene.snapshot().without_camera_lights()
        stored = read_light(path, snapshot)
        baked = cls.__new__(cls)
        baked._scene, baked._settings, baked._shape = scene, stored.settings, shape_of(snapshot)
        lights = lights_of(snapshot) if stored.keys.light == keys_of(snapshot).light else b""
        baked._begin(snapshot, lights, stored.kept, stored)
        return baked

    @property
    def nbytes(self) -> int:
        """Bytes of the light that pictures read."""
        return self._kept.nbytes

    @property
    def levels(self) -> dict[int, int]:
        """How coarse the light of each instance of a model is: 0, a record for each splat; k, for 4^(k - 1) patches.

        Light is coarser where that of all splats would not fit into `BakeSettings.memory`.
        """
        return dict(self._kept.levels)

    @property
    def coarser(self) -> str:
        """In words how coarse the light is; empty where each splat has its own, see `levels`."""
        return coarseness(self._kept.levels)

    def __repr__(self) -> str:
        whence = "from a file" if self._stored is not None else f"{len(self._exchange.transport):,} patches"
        ending = f", {self.coarser}" if self.coarser else ""
        return f"<Baked: {whence}, {self.nbytes / 2**20:.0f} MiB{ending}>"


def bake(
    scene: Scene, settings: BakeSettings | None = None, progress: Progress | None = None, client: Client = None
) -> Baked:
    """Bake the light of a scene: for every instance and plane the light that arrives, after all bounces.

    Parameters
    ----------
    progress : callable, optional
        Called with the share done.
    client : dask.distributed.Client, optional
        The workers of a cluster send the rays (`pip install 'pointray[cluster]'`). The light is the same, on processors
        of one kind to the last bit. `Baked.update` does without them. See docs/scale.md.

    Notes
    -----
    Patches, some of the splats, send rays into the hemisphere; what these hit are links, over which light bounces until
    nothing changes (Goral et al. 1984, with links as in Hanrahan, Salzman and Aupperle 1991, found by rays). Mirrors
    and glass are followed; other surfaces pass light on as if they were matt, of the same albedo. Light that follows
    the camera is not baked. A back side that is nearly dark counts as black.

    Raises
    ------
    ValueError
        If the scene is empty, or `BakeSettings.memory` is too small even for the coarsest light.
    """
    check_kind(scene, "scene", Scene, "a Scene")
    settings = BakeSettings() if settings is None else check_kind(settings, "settings", BakeSettings, "BakeSettings")
    check_callback(progress)
    if not scene.shapes:
        raise ValueError("the scene is empty: there is nothing to bake")
    return Baked(scene, settings, progress, client)
