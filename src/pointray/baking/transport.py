"""Light transport between patches, independent of the lights: the patches of a scene, and their links."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles, Flags, Floats
from ..base.executor import Executor, SharedValue
from ..base.progress import Progress
from ..engine.jit import run, uncompiled
from ..engine.kernels import records as rec, scratch as sc
from ..engine.kernels.records import World
from ..scene.world import Snapshot
from ..shade.grid import MOST_WALLS
from .bounces import CHUNK, Links, bytes_of, hide_links
from .directions import strata
from .gather import FIND_DIRECT, FIND_LINKS, FIND_SUNS, INSIDE, ONE_TILE, Found, Patches, Rays, send_rays
from .patches import NEAR, PIECE
from .planes import Grid, grid_neighbors
from .surfaces import BakeSurface, find_targets
from .tile_ranges import cut, send_ranges, share_patches

NO_FLOATS, NO_INTS, NO_BITS = np.zeros(0, np.float32), np.zeros(0, np.int32), np.zeros(0, np.uint8)
NO_SUNS = np.zeros(0)
BURIED = 0.5  # fraction of links that lead to a dark inside, from which on a patch is not trusted
AREA_SAMPLES = 16  # shadow rays of a patch to an area light
ALL_SIDES = (1, -1)


class Side(NamedTuple):
    """Front or back of an instance, which receives light at patches first to first + size - 1 of a `Transport`.

    surface : geometry and colours of the patches, shared by both sides; sign : 1 for the front, to which normals point,
        -1 for the back
    near : (size, NEAR) int32, neighbours of each patch, as indices within the side, padded with -1
    """

    surface: BakeSurface
    sign: int
    first: int
    size: int
    near: NDArray[np.int32]

    @property
    def span(self) -> slice:
        """Slice of the side's patches among those of all sides."""
        return slice(self.first, self.first + self.size)


class Transport:
    """All patches of the sides of instances that may be lit, one side after the other, and their links.

    Links are rays from a patch to what it receives light from: other patches, and texels of the sky.

    Parameters
    ----------
    surfaces : list of BakeSurface
        The patches of each instance.
    lit : list of (int, int)
        Index of a surface, and 1 for its front or -1 for its back, for each side.
    seed, threads : int
        Of `BakeSettings`.
    executor : Executor, optional
        Sends the rays; None for this process.

    Attributes
    ----------
    sides : list of Side
    positions : (n, 3) float64, world; normals : (n, 3) float32, world, pointing to the patch's side
    albedo, emitted : (n, 3) float32
    trusted : (n,) bool
        False for patches without a surface, or buried: too many rays meet a dark inside. They take light from
        neighbours.
    links : list of Links
        What each ray of each patch met, one item for each round of rays.
    nearness : (n,) float32
        Mean inverse distance of what the rays hit.
    """

    def __init__(
        self,
        scene: Snapshot,
        surfaces: list[BakeSurface],
        lit: list[tuple[int, int]],
        seed: int,
        threads: int | None,
        executor: Executor | None = None,
    ) -> None:
        self.sides: list[Side] = []
        first = 0
        for k, sign in lit:
            near = _neighbors_of(scene.world, surfaces[k])
            self.sides.append(Side(surfaces[k], sign, first, len(near), near))
            first += len(near)
        self.positions: Doubles = self._concatenate_column("positions", np.float64)
        self.albedo: Floats = self._concatenate_column("albedo", np.float32)
        self.emitted: Floats = self._concatenate_column("emitted", np.float32)
        self._lost: Flags = self._concatenate_column("lost", np.bool_)
        self._margins: Floats = self._concatenate_column("margins", np.float32)
        signs = np.repeat([side.sign for side in self.sides], [side.size for side in self.sides])
        self.normals: Floats = self._concatenate_column("normals", np.float32) * signs[:, None].astype(np.float32)
        self._targets = find_targets(surfaces, {(s.surface.instance, s.sign): s.first for s in self.sides})
        self._world, self._seed, self._threads, self._executor = scene.world, seed, threads, executor
        self._shared_patches: SharedValue | None = None  # of the executor
        self.links: list[Links] = []
        self.nearness, self._inside = np.zeros((2, len(self.positions)), np.float32)
        self._set_trust()

    def __len__(self) -> int:
        return len(self.positions)

    def release_executor(self) -> None:
        """Stop using the executor, so that later rays are sent in this process."""
        self._executor = self._shared_patches = None

    def _concatenate_column(self, name: str, dtype: type) -> NDArray[Any]:
        """Concatenate an array of the surfaces, such as "positions", over all sides."""
        parts = [getattr(side.surface, name) for side in self.sides]
        return np.concatenate(parts).astype(dtype, copy=False)

    def shared_surfaces(self) -> list[BakeSurface]:
        """Replace the arrays of all surfaces by views of this object's arrays, to save memory; return the surfaces.

        All fronts must be lit.
        """
        out = []
        for k, side in enumerate(self.sides):
            arrays = {name: getattr(self, name)[side.span] for name in ("positions", "albedo", "emitted")}
            surface = side.surface._replace(**arrays, lost=self._lost[side.span])
            if side.sign > 0:
                surface = surface._replace(normals=self.normals[side.span])
                out.append(surface)
            self.sides[k] = side._replace(surface=surface)
        return out

    def recolor(self, surfaces: list[BakeSurface]) -> None:
        """Take albedo and emission of all patches from the same surfaces with other materials."""
        of = {surface.instance: surface for surface in surfaces}
        self.sides = [side._replace(surface=of[side.surface.instance]) for side in self.sides]
        self.albedo, self.emitted = (
            self._concatenate_column("albedo", np.float32),
            self._concatenate_column("emitted", np.float32),
        )

    def patches(self, rows: NDArray[np.int32] = NO_INTS) -> Patches:
        """Return all patches as kernels read them, with the given ones divided into tiles of up to 64 of one side.

        rows : (m,) increasing indices of the patches to process
        """
        of = np.searchsorted([side.first for side in self.sides], rows, side="right") - 1
        begins = np.flatnonzero(np.diff(of, prepend=-1))
        counts = np.diff(np.append(begins, len(rows)))
        tiles = -(-counts // sc.TILE)
        at = (np.arange(tiles.sum()) - np.repeat(np.cumsum(tiles) - tiles, tiles)) * sc.TILE
        signs = np.array([side.sign for side in self.sides])[of[begins]]
        table = np.empty((len(at), ONE_TILE), np.int64)
        table[:, 0] = at + np.repeat(begins, tiles)
        table[:, 1] = np.minimum(sc.TILE, np.repeat(counts, tiles) - at)
        table[:, 2] = np.repeat(signs, tiles)
        starts = self.positions
        if self._margins.any():
            starts = starts + self.normals * self._margins[:, None]
        return Patches(starts.reshape(-1), self.normals.reshape(-1), rows, table.reshape(-1))

    def send(self, rows: NDArray[np.int32], links: int, progress: Progress | None = None) -> None:
        """Send `links` more rays from some patches, and store what they meet; all rays of a patch have equal weight.

        rows : (m,) increasing indices of the patches
        """
        kinds = self._world.materials[rec.MATERIAL_KIND :: rec.MATERIAL_SIZE]
        tinted = bool(np.isin(kinds, (rec.MIRROR, rec.DIELECTRIC)).any())
        found = Found(
            np.zeros(len(rows) * links, np.int32),
            np.zeros(len(rows) * links if tinted else 0, np.int32),
            np.zeros(len(rows), np.float32),
            NO_FLOATS,
        )
        seed = self._seed + len(self.links)
        self._run(
            rows, self._world, Rays(FIND_LINKS, strata(links), seed, AREA_SAMPLES, tinted, NO_SUNS), found, progress
        )
        self.links.append(
            Links(found.links, found.tints, rows, np.zeros(len(rows), np.float32), NO_BITS, strata(links), seed)
        )
        sent = np.zeros(len(self), np.float32)
        for part in self.links:
            sent[part.rows] += part.parts[0] * part.parts[1]
        inside = _count_inside(found.links, links)
        for mean, more in ((self.nearness, found.nearness), (self._inside, inside)):
            mean[rows] = (mean[rows] * (sent[rows] - links) + more) / sent[rows]
        self._set_trust()
        for part in self.links:
            part.share[:] = part.parts[0] * part.parts[1] / sent[part.rows]

    def _set_trust(self) -> None:
        """Find the patches whose light is valid (`trusted`), and for each other one the nearest trusted neighbour."""
        self.trusted = ~self._lost & (self._inside < BURIED)
        self._untrusted_rows, self._substitute_rows = NO_INTS, NO_INTS
        for side in self.sides:
            trusted = self.trusted[side.span]
            rows = np.flatnonzero(~trusted)
            usable = (side.near[rows] >= 0) & trusted[side.near[rows]]
            nearest = side.near[rows, usable.argmax(axis=1)]
            some = usable.any(axis=1)
            self._untrusted_rows = np.concatenate([self._untrusted_rows, rows[some] + side.first])
            self._substitute_rows = np.concatenate([self._substitute_rows, nearest[some] + side.first])

    def fill_untrusted(self, light: Floats) -> Floats:
        """Replace the light of patches that are buried or have no surface by that of the nearest valid neighbour.

        light : (n, k), changed in place and returned
        """
        light[self._untrusted_rows] = light[self._substitute_rows]
        return light

    def find_hidden_links(self, world: World) -> None:
        """Find the links (rays from a patch to a source of light) that the area lights of this world block."""
        patches, lamps = self.patches(), world.lamps.lights.size > 0
        for k, part in enumerate(self.links):
            count = uncompiled(bytes_of)(part.parts[0] * part.parts[1])
            part = part._replace(hidden=np.zeros(len(part.rows) * count, np.uint8) if lamps else NO_BITS)
            if lamps:
                run(hide_links, -(-len(part.rows) // CHUNK), world, part, patches, threads=self._threads)
            self.links[k] = part

    def find_direct(self, world: World, progress: Progress | None = None) -> Floats:
        """Send shadow rays: return the irradiance of all patches, (n, 3), without that of sky and emissive surfaces."""
        rows, direct = np.arange(len(self), dtype=np.int32), np.zeros((len(self), 3), np.float32)
        rays = Rays(FIND_DIRECT, (1, 1), self._seed, AREA_SAMPLES, False, NO_SUNS)
        self._run(rows, world, rays, Found(NO_INTS, NO_INTS, NO_FLOATS, direct.reshape(-1)), progress)
        return direct

    def find_suns(self, world: World, suns: Doubles) -> Floats:
        """Return the cosine of each patch's normal to each bright spot of the sky, (n, suns) float32; 0 where occluded.

        suns : (suns, 3), unit directions to the spots
        """
        rows, seen = np.arange(len(self), dtype=np.int32), np.zeros((len(self), len(suns)), np.float32)
        if len(suns):
            rays = Rays(FIND_SUNS, (1, 1), self._seed, AREA_SAMPLES, False, suns.reshape(-1))
            self._run(rows, world, rays, Found(NO_INTS, NO_INTS, NO_FLOATS, seen.reshape(-1)), None)
        return seen

    def _run(self, rows: NDArray[np.int32], world: World, rays: Rays, found: Found, progress: Progress | None) -> None:
        patches = self.patches(rows)
        if self._executor is not None:
            self._shared_patches = self._shared_patches or share_patches(patches, self._targets)
            send_ranges(
                self._executor, self._shared_patches, cut(patches, rays, found, self._executor.workers), found, progress
            )
            return
        tiles = len(patches.tiles) // ONE_TILE
        args = world, patches, self._targets, rays, found
        run(send_rays, tiles, *args, threads=self._threads, progress=progress)


def _count_inside(links: NDArray[np.int32], each: int) -> NDArray[np.int32]:
    """Return for each patch how many of its rays met a dark inside, which shows that it is buried.

    links : what each ray met, `each` rays for each patch
    """
    out = np.empty(len(links) // each, np.int32)
    for first in range(0, len(out), PIECE):
        part = links[first * each : (first + PIECE) * each].reshape(-1, each)
        out[first : first + PIECE] = np.count_nonzero(part == INSIDE, axis=1)
    return out


def _neighbors_of(world: World, surface: BakeSurface) -> NDArray[np.int32]:
    """Return the neighbours of each patch of a surface, (count, NEAR) int32, padded with -1.

    On a plane, cells across another plane are no neighbours.
    """
    if not isinstance(surface.patches, Grid):
        return surface.patches.near
    planes = world.planes.reshape(-1, rec.PLANE_SIZE)
    own = int(world.instances[surface.instance * rec.INSTANCE + rec.SHAPE_ROW])
    walls = [plane for k, plane in enumerate(planes) if k != own] if len(planes) <= MOST_WALLS else []
    return grid_neighbors(surface.patches, NEAR, surface.positions, walls)
