"""A piece of a picture, wave after wave: its samples ask, others answer, the samples go on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...engine.jit import Array, run
from ...engine.kernels.records import World
from ...engine.kernels.scratch import TILE
from ...surface.trace.cast import PLAIN, Pace
from ..film import LONGEST_PASS
from ..integrate import BLOCK_EDGE, Pass
from ..pieces import Floats, Piece, cut
from .answer import BEGINS, SLOT, answer
from .replay import FACT_INSTANCE, FACTS, MISS, RAY, ReplayWorld, nothing_asked

RAYS = 1 << 17  # rays of a piece's samples, at most: 8 MiB of them travel at once
TILES = BLOCK_EDGE * BLOCK_EDGE // TILE  # of a block


class Question(NamedTuple):
    """Rays of which somebody is asked what they meet.

    rays, slots : (n, 8) float64, (n,) uint8, see `answer.answer`
    closest : the first so many ask what they meet; the others only whether they meet anything
    """

    rays: NDArray[np.float64]
    slots: NDArray[np.uint8]
    closest: int

    @property
    def nbytes(self) -> int:
        return self.rays.nbytes + self.slots.nbytes

    def of(self, rows: NDArray[np.int64]) -> Question:
        """The question of some of the rays, whose places are given in ascending order."""
        tiles = np.cumsum(self.slots >= BEGINS)[rows]
        return Question(self.rays[rows], _marked(self.slots[rows] & SLOT, tiles), int((rows < self.closest).sum()))


class Answer(NamedTuple):
    """What these rays meet in what somebody holds.

    met : (n / 8,) uint8, bits: which rays meet anything
    facts : (m, FACTS) float64, see `recall.FACTS`, of those of the first that do
    """

    met: NDArray[np.uint8]
    facts: NDArray[np.float64]

    @property
    def nbytes(self) -> int:
        return self.met.nbytes + self.facts.nbytes


def answer_question(world: World, question: Question, pace: Pace = PLAIN) -> Answer:
    """What rays meet in a world."""
    rays, slots, k = question
    instances, facts = answer(world, rays[:k], slots[:k], False, pace)
    blocked, _ = answer(world, rays[k:], slots[k:], True, pace)
    hits = instances >= 0
    met = np.packbits(np.concatenate([hits, blocked >= 0]))
    return Answer(met, np.column_stack([instances[hits].astype(np.float64), facts[hits]]))


@dataclass(frozen=True)
class KernelArguments:
    """What a picture's kernel takes, and how it runs.

    kernel : one of `replay`; world, camera, job : what it takes; film may be empty; threads : see `jit.run`
    """

    kernel: Any
    world: World
    camera: NDArray[np.float64]
    job: Pass
    film: Floats
    image: Floats
    threads: int | None


def pieces_of(size: tuple[int, int], samples: tuple[int, int]) -> list[Piece]:
    """The pieces of a picture, of which each has a bounded number of rays."""
    blocks = -(-size[0] // BLOCK_EDGE) * -(-size[1] // BLOCK_EDGE)
    longest = min(samples[1] - samples[0], LONGEST_PASS)
    return cut(size, max(-(-blocks // max(RAYS // (BLOCK_EDGE * BLOCK_EDGE * longest), 1)), 1))


def passes_of(samples: tuple[int, int]) -> list[tuple[int, int]]:
    """Samples that are added one after the other, where their sums may be rounded: see `film.round_sums`."""
    first, end = samples
    starts = [first, *range((first // LONGEST_PASS + 1) * LONGEST_PASS, end, LONGEST_PASS)]
    return list(zip(starts, [*starts[1:], end], strict=True))


class Waves:
    """Samples of a piece of a picture.

    Until `ask` returns None: give what others know of its rays to `take`, in any order; each nearest hit counts.
    """

    def __init__(self, picture: KernelArguments, piece: Piece, samples: tuple[int, int]) -> None:
        self._picture, self._piece = picture, piece
        self._job = picture.job._replace(first=samples[0], end=samples[1])
        units = piece.blocks * TILES * (samples[1] - samples[0])
        across = -(-picture.image.shape[1] // BLOCK_EDGE)
        self._recall = nothing_asked(units, piece.block, across, samples)
        self._begins, self._found, self._facts = (_Growing(kind) for kind in (np.int64, np.int64, np.float64))
        kept = picture.film.size > 0 and samples[0] > 0
        self._before = piece.of(picture.film).copy() if kept else None
        self._order = np.zeros(0, np.int64)  # of the rays in the question: their places among the answers
        self._closest = 0
        self._best = np.zeros((0, FACTS))
        self._met = np.zeros(0, np.bool_)

    def ask(self, progress: Any = None) -> Question | None:
        """What the samples ask next; None: nothing, the picture has them.

        progress : called while the kernel runs; an error in it ends the work
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
        """Take what somebody knows of some rays. rows : their places in the question"""
        met = np.unpackbits(given.met, count=len(rows)).view(np.bool_)
        hit = rows[met]
        self._met[hit] = True
        hit = hit[hit < self._closest]
        new, old = given.facts, self._best[hit]
        # Of hits at the same place that of the first instance counts, whoever answers first.
        nearer = (new[:, 1] < old[:, 1]) | ((new[:, 1] == old[:, 1]) & (new[:, FACT_INSTANCE] < old[:, FACT_INSTANCE]))
        self._best[hit[nearer]] = new[nearer]

    def _run(self, progress: Any) -> None:
        """Run all samples from their start."""
        picture, piece = self._picture, self._piece
        if self._before is not None:
            piece.of(picture.film)[:] = self._before
        world = ReplayWorld._make((*picture.world, self._recall))
        args = world, picture.camera, self._job, picture.film, picture.image
        run(picture.kernel, piece.blocks, *args, threads=picture.threads, progress=progress, first=piece.block)

    def _question(self) -> Question:
        """The rays that samples have written down: those that ask what they meet, then the others."""
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
        """Put the answers to a question into the table."""
        found = np.full(len(self._met), MISS, np.int64)
        hits = np.flatnonzero(self._met[: self._closest])
        found[self._order[self._closest :][self._met[self._closest :]]] = 0
        found[self._order[hits]] = self._facts.size // FACTS + np.arange(len(hits))
        self._found.add(found)
        self._facts.add(self._best[hits].reshape(-1))
        begins, found, facts = self._begins.all, self._found.all, self._facts.all
        self._recall = self._recall._replace(begins=begins, found=found, facts=facts)


def _marked(slots: NDArray[Any], tiles: NDArray[Any]) -> NDArray[np.uint8]:
    """Slots of rays, with marks where another tile begins. tiles : a number of each ray's tile"""
    return (slots | np.where(np.diff(tiles, prepend=-1) != 0, BEGINS, 0)).astype(np.uint8)


class _Growing:
    """An array that grows at its end."""

    def __init__(self, kind: Any) -> None:
        self._room, self.size = np.zeros(1024, kind), 0

    def add(self, more: Array) -> None:
        """Put numbers at the end."""
        if self.size + more.size > self._room.size:
            room = np.zeros(2 * (self.size + more.size), self._room.dtype)
            room[: self.size] = self._room[: self.size]
            self._room = room
        self._room[self.size : self.size + more.size] = more
        self.size += more.size

    @property
    def all(self) -> Array:
        """All numbers."""
        return self._room[: self.size]
