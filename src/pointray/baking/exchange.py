"""The patches of a scene, how light passes between them, and the light that arrives at them: the stages of a bake."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.executor import Executor
from ..base.progress import Progress, part_of, tell
from ..engine.kernels.records import INSTANCE, KIND, MODEL
from ..engine.kernels.vec import LUMINANCE
from ..scene.world import Snapshot
from .bounces import VARIANCE
from .budget import spreads_within
from .fingerprints import materials_of
from .settings import BakeSettings
from .sky import Sky, look_at_sky
from .solve import Arrived, find_lights, smoothed, solve
from .surfaces import Sheet, coarser, find_sheets, leveled, recolored
from .transport import ALL_SIDES, Side, Transport

LEAST_CHOSEN, MOST_CHOSEN = 1 << 15, 1 << 20  # patches, where their number is left to us
# Patches and links of the rough light that decides which sides are dark. Where there are few patches these are one in
# PROBE_SHARE, but no fewer than LEAST_PROBES.
LEAST_PROBES, PROBES, PROBE_SHARE, PROBE_LINKS = 1 << 11, 1 << 13, 4, 16
DARK = 0.02  # a back side with less than this share of the light of the brightest side is kept as black
MOST_ROUNDS = 3  # of further links where there is noise
DIM = 0.1  # share of the mean light: noise counts as a share of no less than this

Floats = NDArray[np.float32]


class Exchange:
    """Lights a scene; then follows other lights and materials without new links.

    Attributes
    ----------
    transport : Transport
        The patches of the sides that are lit, and their links.
    sides : dict
        These sides, by the number of the instance and the sign.
    arrived : Arrived
        The light at the patches.
    levels, spreads : see `Kept.levels`, and `levels.Spread` by the numbers of instances with coarser light
    """

    def __init__(
        self, scene: Snapshot, settings: BakeSettings, progress: Progress | None, executor: Executor | None = None
    ) -> None:
        self._settings, self._executor = settings, executor
        self._sheets = find_sheets(scene, _chosen(scene, settings), settings.albedo_scale)
        self._materials = materials_of(scene)
        tell(progress, 0.1)
        sky = look_at_sky(scene.world)
        self._probe = _probe(scene, self._sheets, settings, executor)
        self._find(scene, sky, _lit_sides(scene, sky, self._probe, settings), part_of(progress, 0.1, 0.9))
        self._executor = None  # later light is found here
        self._probe.dismiss()
        self.transport.dismiss()

    def _find(self, scene: Snapshot, sky: Sky, lit: list[tuple[int, int]], progress: Progress | None) -> None:
        """Find the links of the sides that are lit, more where there is noise; and the light along them."""
        settings, self._lit = self._settings, lit
        transport = Transport(scene, self._sheets, lit, settings.seed, settings.threads, self._executor)
        self._sheets = transport.shared_sheets()
        found = spreads_within(scene, transport.sides, settings.memory)
        rows = np.arange(len(transport), dtype=np.int32)
        transport.send(rows, settings.links, part_of(progress, 0.0, 0.7))
        seen = find_lights(scene.world, sky, transport)
        arrived = solve(scene.world, transport, settings, seen)
        noisy = _noisy(transport, *smoothed(transport, arrived, settings.threads), settings.noise)
        for k in range(MOST_ROUNDS):
            rows = np.flatnonzero(noisy > 1.0 + k).astype(np.int32)
            if len(rows):
                transport.send(rows, settings.links, part_of(progress, 0.7 + 0.1 * k, 0.8 + 0.1 * k))
        if len(transport.links) > 1:
            transport.meet(scene.world)
            arrived = solve(scene.world, transport, settings, seen)
        self.transport, (self.levels, self.spreads) = transport, found
        self._keep(scene, arrived)

    def _keep(self, scene: Snapshot, arrived: Arrived) -> None:
        self.arrived, _ = smoothed(self.transport, arrived, self._settings.threads)
        self.sides: dict[tuple[int, int], Side] = {
            (int(scene.keys[side.sheet.instance]), side.sign): side for side in self.transport.sides
        }

    def follow(self, scene: Snapshot, other_levels: bool, progress: Progress | None) -> None:
        """The light of another scene with the same models and planes.

        other_levels : whether models have other levels of detail than before
        """
        if other_levels:
            self._sheets = leveled(scene, self._sheets)
        if materials_of(scene) != self._materials:
            self._materials = materials_of(scene)
            self._sheets = recolored(scene, self._sheets, self._settings.albedo_scale)
        # Links may be shared with light for other materials, see `Baked.relit`.
        self._probe.recolor(_few(self._sheets))
        self.transport.recolor(self._sheets)
        if other_levels:
            self.levels, self.spreads = spreads_within(scene, self.transport.sides, self._settings.memory)
        sky = look_at_sky(scene.world)
        lit = _lit_sides(scene, sky, self._probe, self._settings)
        if lit != self._lit:
            self._find(scene, sky, lit, progress)
            return
        seen = find_lights(scene.world, sky, self.transport)
        self._keep(scene, solve(scene.world, self.transport, self._settings, seen))


def _chosen(scene: Snapshot, settings: BakeSettings) -> int:
    """About how many patches there are."""
    if settings.patches is not None:
        return settings.patches
    records = scene.world.instances.reshape(-1, INSTANCE)
    shapes = records[records[:, KIND] == MODEL, 1].astype(int)
    splats = sum(len(scene.models[k].points) for k in shapes)
    return int(np.clip(splats // 2, LEAST_CHOSEN, MOST_CHOSEN))


def _probe(scene: Snapshot, sheets: list[Sheet], settings: BakeSettings, executor: Executor | None) -> Transport:
    """Few patches on both sides of all sheets, with few links."""
    sides = [(k, sign) for k in range(len(sheets)) for sign in ALL_SIDES]
    probe = Transport(scene, _few(sheets), sides, settings.seed, settings.threads, executor)
    probe.send(np.arange(len(probe), dtype=np.int32), PROBE_LINKS)
    return probe


def _few(sheets: list[Sheet]) -> list[Sheet]:
    """The sheets of the probe."""
    patches = sum(len(sheet.positions) for sheet in sheets)
    most = min(max(patches // PROBE_SHARE, LEAST_PROBES), PROBES)
    return coarser(sheets, max(most // len(sheets), 16))


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
