"""Baked light: what `bake` returns, and the stages in which it is made."""

from __future__ import annotations

import copy
import os
import warnings
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..arguments import check_callback, check_kind, check_path, wrong
from ..jit import Array
from ..kernels.records import INSTANCE, KIND, MODEL
from ..kernels.vec import LUMINANCE
from ..model import Model
from ..progress import Progress, part_of, tell
from ..scene.scene import Scene
from ..scene.world import Snapshot
from .bounces import VARIANCE
from .budget import coarseness, levels_of, spreads_within
from .file import Stored, read_light, write_light
from .kept import Kept
from .keys import keys_of, lacks_levels, lights_of, materials_of, shape_of
from .planes import Grid
from .settings import BakeSettings
from .sky import Sky, look_at_sky
from .solve import Arrived, find_lights, smoothed, solve
from .store import AtSplats, at_points, dark, from_patches, from_records, make_records, seen_skies, unit_of
from .surfaces import Sheet, coarser, find_sheets, leveled, recolored
from .transport import ALL_SIDES, Transport

LEAST_CHOSEN, MOST_CHOSEN = 1 << 15, 1 << 20  # patches, where their number is left to us
PROBES, PROBE_LINKS = 1 << 13, 16  # patches and links of the rough light that tells which sides are dark
DARK = 0.02  # a back side with less than this share of the light of the brightest side is kept as black
NO_LEVELS = "levels of detail were made after the bake: call update(), or bake again"
MOST_ROUNDS = 3  # of further links where there is noise
DIM = 0.1  # share of the mean light: noise counts as a share of no less than this

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

    def __init__(self, scene: Scene, settings: BakeSettings, progress: Progress | None) -> None:
        self._scene, self._settings = scene, settings
        self._bake(scene.snapshot().without_camera_lights(), progress)

    def _bake(self, snapshot: Snapshot, progress: Progress | None) -> None:
        self._sheets = find_sheets(snapshot, _chosen(snapshot, self._settings), self._settings.albedo_scale)
        self._materials = materials_of(snapshot)
        tell(progress, 0.1)
        sky = look_at_sky(snapshot.world)
        self._probe = _probe(snapshot, self._sheets, self._settings)
        lit = _lit_sides(snapshot, sky, self._probe, self._settings)
        self._light(snapshot, self._gather(snapshot, sky, lit, part_of(progress, 0.1, 0.9)))
        tell(progress, 1.0)

    def _gather(self, snapshot: Snapshot, sky: Sky, lit: list[tuple[int, int]], progress: Progress | None) -> Arrived:
        """Find the links of the sides that are lit, more where there is noise; and the light along them."""
        settings, self._lit = self._settings, lit
        transport = Transport(snapshot, self._sheets, self._lit, settings.seed, settings.threads)
        self._sheets = transport.shared_sheets()
        found = spreads_within(snapshot, transport.sides, settings.memory)
        rows = np.arange(len(transport), dtype=np.int32)
        transport.send(rows, settings.links, part_of(progress, 0.0, 0.7))
        seen = find_lights(snapshot.world, sky, transport)
        arrived = solve(snapshot.world, transport, settings, seen)
        noisy = _noisy(transport, *smoothed(transport, arrived, settings.threads), settings.noise)
        for k in range(MOST_ROUNDS):
            rows = np.flatnonzero(noisy > 1.0 + k).astype(np.int32)
            if len(rows):
                transport.send(rows, settings.links, part_of(progress, 0.7 + 0.1 * k, 0.8 + 0.1 * k))
        if len(transport.links) > 1:
            transport.meet(snapshot.world)
            arrived = solve(snapshot.world, transport, settings, seen)
        self._transport = transport
        self._levels, self._spreads = found
        self._shape = shape_of(snapshot)
        return arrived

    def _light(self, snapshot: Snapshot, arrived: Arrived) -> None:
        """Write the records of the light that arrives."""
        settings, transport = self._settings, self._transport
        self._arrived, _ = smoothed(transport, arrived, settings.threads)
        if not self._arrived.direct.any() and not self._arrived.indirect.any():
            warnings.warn("the scene has no light: what is baked is black", stacklevel=5)
        unit, numbers, records = unit_of(self._arrived), snapshot.numbers, {}
        self._sides = {(int(numbers[side.sheet.instance]), side.sign): side for side in transport.sides}
        for (number, sign), side in self._sides.items():
            spread = self._spreads.get(number)
            for level in range(levels_of(side)) if spread is None else (0,):
                of = level if spread is None else spread
                records[number, sign, level] = make_records(side, of, self._arrived, unit, settings.threads)
        patches = {number: side.sheet.patches for (number, _), side in self._sides.items()}
        grids = {number: grid for number, grid in patches.items() if isinstance(grid, Grid)}
        blocks = {number: spread.blocks for number, spread in self._spreads.items()}
        self._begin(snapshot, lights_of(snapshot), Kept(unit, records, grids, blocks, self._levels))

    def _begin(self, snapshot: Snapshot, lights: bytes, kept: Kept, stored: Stored | None = None) -> None:
        """Keep light, the scene that it is of, and the file's contents if it is from one."""
        self._baked_of, self._lights = snapshot._replace(baked=None), lights
        self._kept, self._stored = kept, stored
        self._checked: Snapshot | None = None
        self._reason: str | None = None
        self._warned: str | None = None

    @property
    def stale(self) -> str | None:
        """Why the light no longer fits the scene; None: it does."""
        return self._stale(self._scene.snapshot())

    def _stale(self, snapshot: Snapshot) -> str | None:
        if snapshot is self._checked:
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
        self._checked, self._reason = snapshot, reason
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
        others = shape != self._shape
        if others:
            self._sheets, self._shape = leveled(snapshot, self._sheets), shape
        if materials_of(snapshot) != self._materials:
            self._materials = materials_of(snapshot)
            self._sheets = recolored(snapshot, self._sheets, self._settings.albedo_scale)
        # Links are shared with light for other materials, see `relit`.
        self._probe.recolor(_few(self._sheets))
        self._transport.recolor(self._sheets)
        if others:
            self._levels, self._spreads = spreads_within(snapshot, self._transport.sides, self._settings.memory)
        sky = look_at_sky(snapshot.world)
        lit = _lit_sides(snapshot, sky, self._probe, self._settings)
        if lit != self._lit:
            arrived = self._gather(snapshot, sky, lit, progress)
        else:
            seen = find_lights(snapshot.world, sky, self._transport)
            arrived = solve(snapshot.world, self._transport, self._settings, seen)
        self._light(snapshot, arrived)
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
            warnings.warn(f"the baked light no longer fits the scene: {reason}", StaleLightWarning, stacklevel=6)
        self._warned = reason
        return self._kept.tables(scene, levels)

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
        slots = self._kept.slots_of(id) if front is not None else 0
        if not isinstance(model, Model) or slots != len(model.tree.order):
            raise ValueError(f"no light is baked for a model {id!r}: id is what `Scene.add` returned for one")
        records = self._kept.records.get((id, sign, 0))
        if records is None:
            at = dark(slots)
        elif self._stored is None:
            at = from_patches(self._sides[id, sign], self._arrived)
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
        return Stored(
            self._settings, keys_of(self._baked_of), self._kept, seen_skies(self._sides, self._arrived, self._spreads)
        )

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
        whence = "from a file" if self._stored is not None else f"{len(self._transport):,} patches"
        ending = f", {self.coarser}" if self.coarser else ""
        return f"<Baked: {whence}, {self.nbytes / 2**20:.0f} MiB{ending}>"


def bake(scene: Scene, settings: BakeSettings | None = None, progress: Progress | None = None) -> Baked:
    """Bake the light of a scene: for every instance and plane the light that arrives, after all bounces.

    Parameters
    ----------
    progress : callable, optional
        Called with the share done.

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
    return Baked(scene, settings, progress)


def _chosen(scene: Snapshot, settings: BakeSettings) -> int:
    """About how many patches there are."""
    if settings.patches is not None:
        return settings.patches
    records = scene.world.instances.reshape(-1, INSTANCE)
    shapes = records[records[:, KIND] == MODEL, 1].astype(int)
    splats = sum(len(scene.models[k].points) for k in shapes)
    return int(np.clip(splats // 2, LEAST_CHOSEN, MOST_CHOSEN))


def _probe(scene: Snapshot, sheets: list[Sheet], settings: BakeSettings) -> Transport:
    """Few patches on both sides of all sheets, with few links."""
    sides = [(k, sign) for k in range(len(sheets)) for sign in ALL_SIDES]
    probe = Transport(scene, _few(sheets), sides, settings.seed, settings.threads)
    probe.send(np.arange(len(probe), dtype=np.int32), PROBE_LINKS)
    return probe


def _few(sheets: list[Sheet]) -> list[Sheet]:
    return coarser(sheets, max(PROBES // len(sheets), 16))


def _lit_sides(scene: Snapshot, sky: Sky, probe: Transport, settings: BakeSettings) -> list[tuple[int, int]]:
    """The fronts of all sheets, and the backs that are lit, as the light at few patches tells: (sheet, sign)."""
    arrived = solve(scene.world, probe, settings, find_lights(scene.world, sky, probe))
    light = (arrived.direct + arrived.indirect) @ np.array(LUMINANCE, np.float32)
    means = [float(light[side.span].mean()) for side in probe.sides]
    limit = DARK * max(means)
    lit = [side.sign > 0 or (mean > limit and limit > 0.0) for side, mean in zip(probe.sides, means, strict=True)]
    return [(k // 2, side.sign) for k, side in enumerate(probe.sides) if lit[k]]


def _noisy(transport: Transport, arrived: Arrived, count: Floats, noise: float) -> Floats:
    """By how much the variance of each patch's light is above what is aimed at."""
    weights = np.array(LUMINANCE, np.float32)
    light = (arrived.direct + arrived.indirect) @ weights
    least = DIM * float(light.mean())
    aim = noise * np.maximum(light, max(least, 1e-15))
    return np.asarray(arrived.facts[:, VARIANCE] / np.maximum(count, 1.0) / (aim * aim), np.float32)
