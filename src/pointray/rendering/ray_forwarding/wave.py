"""Waves of a piece of an image: its samples send rays, holders answer, the samples continue."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Doubles, Floats
from ...engine.jit import Array, run
from ...engine.kernels.records import World
from ...engine.kernels.scratch import TILE
from ...surface.trace.cast import PLAIN, Pace
from ..film import LONGEST_PASS
from ..integrate import BLOCK_EDGE, Pass
from ..pieces import Piece, cut
from .answer import BEGINS, SLOT, answer
from .replay import FACT_INSTANCE, FACTS, MISS, RAY, ReplayWorld, empty_table

RAYS = 1 << 17  # maximum rays of a piece's samples: 8 MiB
TILES = BLOCK_EDGE * BLOCK_EDGE // TILE  # tiles a block


class Question(NamedTuple):
    """Query: rays of a piece of an image, sent to a worker for intersection.

    rays : (n, 8) float64, origin, unit direction, largest t, side (+1 if a ray that starts on a surface is outside of
        it, else -1)
    slots : (n,) uint8, index of each ray in its tile, plus `BEGINS` at the first ray of a tile
    closest : number of closest-hit rays, which come first; the others are occlusion rays
    """

    rays: Doubles
    slots: NDArray[np.uint8]
    closest: int

    @property
    def nbytes(self) -> int:
        return self.rays.nbytes + self.slots.nbytes

    def of(self, rows: NDArray[np.int64]) -> Question:
        """Return a query of some of the rays, for one worker. rows : of these rays, ascending"""
        tiles = np.cumsum(self.slots >= BEGINS)[rows]
        return Question(self.rays[rows], _marked(self.slots[rows] & SLOT, tiles), int((rows < self.closest).sum()))


class Answer(NamedTuple):
    """Hits of a query's rays with the models that one worker holds.

    met : (n / 8,) uint8, bits: which rays hit anything
    facts : (m, FACTS) float64, of the closest-hit rays that hit: instance, t, normal, colour, and the offset of
        secondary rays from the surface
    """

    met: NDArray[np.uint8]
    facts: Doubles

    @property
    def nbytes(self) -> int:
        return self.met.nbytes + self.facts.nbytes


def answer_query(world: World, question: Question, pace: Pace = PLAIN) -> Answer:
    """Intersect the rays of a query with a world, and return their hits. pace : number of threads, progress callback"""
    rays, slots, k = question
    instances, facts = answer(world, rays[:k], slots[:k], False, pace)
    blocked, _ = answer(world, rays[k:], slots[k:], True, pace)
    hits = instances >= 0
    met = np.packbits(np.concatenate([hits, blocked >= 0]))
    return Answer(met, np.column_stack([instances[hits].astype(np.float64), facts[hits]]))


@dataclass(frozen=True)
class KernelArguments:
    """A rendering kernel and its arguments, to render an image whose rays are sent to workers.

    kernel : a version of the kernel that reads hits with models from a table
    camera : (16,), eye, axes, projection and lens
    job : settings of the image and range of all samples
    film : (h, w, k), k sums over the samples of each pixel (RGB, hits and so on), or empty
    image : (h, w, 4), result: mean RGB over the background, and alpha
    threads : number of threads; None: `POINTRAY_THREADS`, else all
    """

    kernel: Any
    world: World
    camera: Doubles
    job: Pass
    film: Floats
    image: Floats
    threads: int | None


def pieces_of(size: tuple[int, int], samples: tuple[int, int]) -> list[Piece]:
    """Return the pieces into which an image is divided to limit the memory for the rays of a pass.

    A pass (a range of samples) of a piece has at most about RAYS (131,072) camera rays.

    size : width and height in pixels; samples : range of sample indices
    """
    blocks = -(-size[0] // BLOCK_EDGE) * -(-size[1] // BLOCK_EDGE)
    longest = min(samples[1] - samples[0], LONGEST_PASS)
    return cut(size, max(-(-blocks // max(RAYS // (BLOCK_EDGE * BLOCK_EDGE * longest), 1)), 1))


def passes_of(samples: tuple[int, int]) -> list[tuple[int, int]]:
    """Divide a range of samples into passes, which end where sums may be rounded to float32 without changing the image.

    samples : range of sample indices, (first, end); so is each pass
    """
    first, end = samples
    starts = [first, *range((first // LONGEST_PASS + 1) * LONGEST_PASS, end, LONGEST_PASS)]
    return list(zip(starts, [*starts[1:], end], strict=True))


class Waves:
    """Samples of a piece of an image, which stop whenever they need hits of rays that workers must find.

    Call `ask` until it returns None, passing the hits from all workers to `take` after each call, in any order.

    picture : the rendering kernel and its arguments, among them the image; samples : range of sample indices
    """

    def __init__(self, picture: KernelArguments, piece: Piece, samples: tuple[int, int]) -> None:
        self._picture, self._piece = picture, piece
        self._job = picture.job._replace(first=samples[0], end=samples[1])
        units = piece.blocks * TILES * (samples[1] - samples[0])
        across = -(-picture.image.shape[1] // BLOCK_EDGE)
        self._recall = empty_table(units, piece.block, across, samples)
        self._begins, self._found, self._facts = (_Growing(kind) for kind in (np.int64, np.int64, np.float64))
        kept = picture.film.size > 0 and samples[0] > 0
        self._before = piece.of(picture.film).copy() if kept else None
        self._order = np.zeros(0, np.int64)  # index in the answers of each ray of the query
        self._closest = 0
        self._best = np.zeros((0, FACTS))
        self._met = np.zeros(0, np.bool_)

    def ask(self, progress: Any = None) -> Question | None:
        """Return the next rays to be intersected, or None if the samples are finished and added to the image.

        progress : called while the kernel runs; an exception in it ends the call
        """
        recall = self._recall
        if recall.turns > 0:
            self._keep_answers()
        recall.asked[:] = 0
        self._run(progress)
        if not recall.asked.any():
            if recall.turns > 0:
                self._recall = self._recall._replace(last=True)
                self._run(progress)
            return None
        return self._question()

    def take(self, rows: NDArray[np.int64], given: Answer) -> None:
        """Merge the hits that a worker returned with those of other workers: the nearest hit of each ray is kept.

        rows : rows in the query of the rays sent to this worker, ascending; given : the hits of these rays
        """
        met = np.unpackbits(given.met, count=len(rows)).view(np.bool_)
        hit = rows[met]
        self._met[hit] = True
        hit = hit[hit < self._closest]
        new, old = given.facts, self._best[hit]
        # Ties go to the first instance, whatever the order of answers.
        nearer = (new[:, 1] < old[:, 1]) | ((new[:, 1] == old[:, 1]) & (new[:, FACT_INSTANCE] < old[:, FACT_INSTANCE]))
        self._best[hit[nearer]] = new[nearer]

    def _run(self, progress: Any) -> None:
        """Run the kernel for all samples from the start, with all hits found so far."""
        picture, piece = self._picture, self._piece
        if self._before is not None:
            piece.of(picture.film)[:] = self._before
        world = ReplayWorld._make((*picture.world, self._recall))
        args = world, picture.camera, self._job, picture.film, picture.image
        run(picture.kernel, piece.blocks, *args, threads=picture.threads, progress=progress, first=piece.block)

    def _question(self) -> Question:
        """Return the rays that the samples have stored in the table: closest-hit rays, then occlusion rays."""
        recall = self._recall
        asking = np.flatnonzero(recall.asked)
        tiles, places = np.nonzero(recall.asked[asking, None] >> np.arange(TILE) & 1)
        rays = recall.rays.reshape(recall.units, TILE, RAY)[asking[tiles], places]
        counts = np.bincount(tiles)
        begins = np.full(recall.units, MISS, np.int64)
        begins[asking] = self._found.size + np.cumsum(counts) - counts
        self._begins.add(begins)
        slots = _marked(places, tiles)
        any_hit = np.repeat(recall.kinds[asking] != 0, counts)
        self._order = np.argsort(any_hit, kind="stable")
        self._closest = len(rays) - int(any_hit.sum())
        self._best = np.full((self._closest, FACTS), np.inf)
        self._met = np.zeros(len(rays), np.bool_)
        self._recall = recall._replace(turns=recall.turns + 1)
        return Question(rays[self._order], slots[self._order], self._closest)

    def _keep_answers(self) -> None:
        """Append the hits of the last query's rays to the table from which samples read."""
        found = np.full(len(self._met), MISS, np.int64)
        hits = np.flatnonzero(self._met[: self._closest])
        found[self._order[self._closest :][self._met[self._closest :]]] = 0
        found[self._order[hits]] = self._facts.size // FACTS + np.arange(len(hits))
        self._found.add(found)
        self._facts.add(self._best[hits].reshape(-1))
        begins, found, facts = self._begins.all, self._found.all, self._facts.all
        self._recall = self._recall._replace(begins=begins, found=found, facts=facts)


def _marked(slots: NDArray[Any], tiles: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the index of each ray in its tile, (n,) uint8, with the bit `BEGINS` set at the first ray of each tile.

    slots : the indices, 0 to 63; tiles : tile of each ray, ascending
    """
    return (slots | np.where(np.diff(tiles, prepend=-1) != 0, BEGINS, 0)).astype(np.uint8)


class _Growing:
    """One-dimensional array to which numbers are appended in amortized constant time. kind : its dtype"""

    def __init__(self, kind: Any) -> None:
        self._room, self.size = np.zeros(1024, kind), 0

    def add(self, more: Array) -> None:
        """Append an array of numbers."""
        if self.size + more.size > self._room.size:
            room = np.zeros(2 * (self.size + more.size), self._room.dtype)
            room[: self.size] = self._room[: self.size]
            self._room = room
        self._room[self.size : self.size + more.size] = more
        self.size += more.size

    @property
    def all(self) -> Array:
        """All numbers appended so far, as a view."""
        return self._room[: self.size]
