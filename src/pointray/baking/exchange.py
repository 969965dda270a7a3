"""Stages of a bake: patches of a scene, light transport between them, and the light that arrives at them."""

from __future__ import annotations

import numpy as np

from ..base.arrays import Floats
from ..base.executor import Executor
from ..base.progress import Progress, part_of, report_progress
from ..engine.kernels.records import INSTANCE, KIND, MODEL
from ..engine.kernels.vec import LUMINANCE
from ..scene.world import Snapshot
from .bounces import VARIANCE
from .budget import spreads_within
from .fingerprints import material_key
from .settings import BakeSettings
from .sky import Sky, sample_sky
from .solve import ArrivingLight, find_lights, smoothed, solve
from .surfaces import BakeSurface, coarser, find_surfaces, with_levels, with_materials
from .transport import ALL_SIDES, Side, Transport

LEAST_CHOSEN, MOST_CHOSEN = 1 << 15, 1 << 20  # limits of the default number of patches
# Patches and links of the rough solution that finds the dark sides. With few patches in the scene it uses one in
# PROBE_SHARE of them, but at least LEAST_PROBES.
LEAST_PROBES, PROBES, PROBE_SHARE, PROBE_LINKS = 1 << 11, 1 << 13, 4, 16
DARK = 0.02  # back sides with less than this fraction of the brightest side's light are black
MOST_ROUNDS = 3  # of additional links where light is noisy
DIM = 0.1  # noise is relative to at least this fraction of the mean light


class Exchange:
    """Light exchanged between the patches of a scene after all bounces; `relight` updates it for other lights.

    Attributes
    ----------
    transport : Transport
        The patches of all sides that receive light, and their links: rays to the patches and sky that illuminate them.
    sides : dict of Side
        Sides of instances that receive light, by instance number and sign: 1 for the front, -1 for the back.
    arrived : ArrivingLight
        The light at the patches, with noise reduced.
    levels : dict of int
        Coarseness of each instance's light, by instance number: 0 is a record per splat, k one per 4^(k - 1) patches.
    spreads : dict of Spread
        Interpolation of coarser light, by instance number.
    """

    def __init__(
        self, scene: Snapshot, settings: BakeSettings, progress: Progress | None, executor: Executor | None = None
    ) -> None:
        self._settings, self._executor = settings, executor
        self._surfaces = find_surfaces(scene, _patch_count(scene, settings), settings.albedo_scale)
        self._materials = material_key(scene)
        report_progress(progress, 0.1)
        sky = sample_sky(scene.world)
        self._probe = _probe(scene, self._surfaces, settings, executor)
        self._find(scene, sky, _lit_sides(scene, sky, self._probe, settings), part_of(progress, 0.1, 0.9))
        self._executor = None  # updates run in this process
        self._probe.release_executor()
        self.transport.release_executor()

    def _find(self, scene: Snapshot, sky: Sky, lit: list[tuple[int, int]], progress: Progress | None) -> None:
        """Cast rays from all patches of the lit sides, more where light is noisy, and compute and store their light.

        sky : radiance of the sky
        lit : (index of a surface, 1 for its front or -1 for its back) for each side that receives light
        """
        settings, self._lit = self._settings, lit
        transport = Transport(scene, self._surfaces, lit, settings.seed, settings.threads, self._executor)
        self._surfaces = transport.shared_surfaces()
        found = spreads_within(scene, transport.sides, settings.memory)
        rows = np.arange(len(transport), dtype=np.int32)
        transport.send(rows, settings.links, part_of(progress, 0.0, 0.7))
        seen = find_lights(scene.world, sky, transport)
        arrived = solve(scene.world, transport, settings, seen)
        noisy = _variance_ratio(*smoothed(transport, arrived, settings.threads), settings.noise)
        for k in range(MOST_ROUNDS):
            rows = np.flatnonzero(noisy > 1.0 + k).astype(np.int32)
            if len(rows):
                transport.send(rows, settings.links, part_of(progress, 0.7 + 0.1 * k, 0.8 + 0.1 * k))
        if len(transport.links) > 1:
            transport.find_hidden_links(scene.world)
            arrived = solve(scene.world, transport, settings, seen)
        self.transport, (self.levels, self.spreads) = transport, found
        self._keep(scene, arrived)

    def _keep(self, scene: Snapshot, arrived: ArrivingLight) -> None:
        self.arrived, _ = smoothed(self.transport, arrived, self._settings.threads)
        self.sides: dict[tuple[int, int], Side] = {
            (int(scene.keys[side.surface.instance]), side.sign): side for side in self.transport.sides
        }

    def relight(self, scene: Snapshot, other_levels: bool, progress: Progress | None) -> None:
        """Compute the light of a scene with the same models and planes but other lights, materials or levels of detail.

        Rays between patches are traced again only if other sides of instances receive light now.

        other_levels : whether the levels of detail of models have changed
        """
        if other_levels:
            self._surfaces = with_levels(scene, self._surfaces)
        if material_key(scene) != self._materials:
            self._materials = material_key(scene)
            self._surfaces = with_materials(scene, self._surfaces, self._settings.albedo_scale)
        # Links may be shared with a scene that has other materials, see `Baked.relit`.
        self._probe.recolor(_coarse_surfaces(self._surfaces))
        self.transport.recolor(self._surfaces)
        if other_levels:
            self.levels, self.spreads = spreads_within(scene, self.transport.sides, self._settings.memory)
        sky = sample_sky(scene.world)
        lit = _lit_sides(scene, sky, self._probe, self._settings)
        if lit != self._lit:
            self._find(scene, sky, lit, progress)
            return
        seen = find_lights(scene.world, sky, self.transport)
        self._keep(scene, solve(scene.world, self.transport, self._settings, seen))


def _patch_count(scene: Snapshot, settings: BakeSettings) -> int:
    """Return the approximate number of patches for all models: as set, or half the splats within limits."""
    if settings.patches is not None:
        return settings.patches
    records = scene.world.instances.reshape(-1, INSTANCE)
    shapes = records[records[:, KIND] == MODEL, 1].astype(int)
    splats = sum(len(scene.models[k].points) for k in shapes)
    return int(np.clip(splats // 2, LEAST_CHOSEN, MOST_CHOSEN))


def _probe(
    scene: Snapshot, surfaces: list[BakeSurface], settings: BakeSettings, executor: Executor | None
) -> Transport:
    """Return few patches on both sides of all surfaces, with few rays each, to find roughly which sides are lit."""
    sides = [(k, sign) for k in range(len(surfaces)) for sign in ALL_SIDES]
    probe = Transport(scene, _coarse_surfaces(surfaces), sides, settings.seed, settings.threads, executor)
    probe.send(np.arange(len(probe), dtype=np.int32), PROBE_LINKS)
    return probe


def _coarse_surfaces(surfaces: list[BakeSurface]) -> list[BakeSurface]:
    """Return the surfaces with fewer patches, for the rough solution that shows which sides are lit."""
    patches = sum(len(surface.positions) for surface in surfaces)
    most = min(max(patches // PROBE_SHARE, LEAST_PROBES), PROBES)
    return coarser(surfaces, max(most // len(surfaces), 16))


def _lit_sides(scene: Snapshot, sky: Sky, probe: Transport, settings: BakeSettings) -> list[tuple[int, int]]:
    """Return (index of a surface, 1 for front or -1 for back) of all fronts, and of the backs that are not nearly dark.

    probe : few patches on both sides of all surfaces, whose light is computed for this decision
    """
    arrived = solve(scene.world, probe, settings, find_lights(scene.world, sky, probe))
    light = (arrived.direct + arrived.indirect) @ np.array(LUMINANCE, np.float32)
    means = [float(light[side.span].mean()) for side in probe.sides]
    limit = DARK * max(means)
    lit = [side.sign > 0 or (mean > limit and limit > 0.0) for side, mean in zip(probe.sides, means, strict=True)]
    return [(k // 2, side.sign) for k, side in enumerate(probe.sides) if lit[k]]


def _variance_ratio(arrived: ArrivingLight, count: Floats, noise: float) -> Floats:
    """Return the variance of each patch's light over the allowed one, (n,); above 1 the patch needs more rays.

    arrived, count : light after noise reduction, and the effective number of patches averaged for each patch, (n,)
    noise : allowed standard error relative to the light
    """
    weights = np.array(LUMINANCE, np.float32)
    light = (arrived.direct + arrived.indirect) @ weights
    least = DIM * float(light.mean())
    aim = noise * np.maximum(light, max(least, 1e-15))
    return np.asarray(arrived.facts[:, VARIANCE] / np.maximum(count, 1.0) / (aim * aim), np.float32)
