"""A picture in pieces of whole blocks, whose samples the workers of a cluster add.

Samples are the same, and are summed in the same order, as when a picture is made at once: a piece is given the numbers
of its samples, and the sums of those before, and may be interrupted only where sums are rounded (`film.round_sums`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.executor import Executor, Job
from .camera import Camera
from .film import LONGEST_PASS
from .integrate import BLOCK_EDGE
from .settings import Settings

PIECES = 8  # for each worker, so that all end at about the same time
FEWEST_BLOCKS = 4  # of a piece, for each thread of a worker
MOST_PIXELS = 1 << 16  # of a piece, or twice that where rows are long: it is sent in one message, with its sums

Floats = NDArray[np.float32]


class Piece(NamedTuple):
    """A part of a picture.

    block, blocks : number of its first block, and how many there are
    rows, columns : of pixels: first one, and the one after the last
    """

    block: int
    blocks: int
    rows: tuple[int, int]
    columns: tuple[int, int]

    def of(self, image: Floats) -> Floats:
        """The piece of an array of the whole picture."""
        return image[slice(*self.rows), slice(*self.columns)]


@dataclass(frozen=True)
class Order:
    """Samples of a piece of a picture.

    Attributes
    ----------
    background : RGB and alpha, or None
        None: the scene's.
    samples : (int, int)
        The number of the first one, and of the one after the last.
    sums : (h, w, k) float32, or None
        Of the samples before; None: there are none.
    returns : bool
        Whether the sums are wanted.
    """

    camera: Camera
    settings: Settings
    background: tuple[float, float, float, float] | None
    samples: tuple[int, int]
    piece: Piece = Piece(0, 0, (0, 0), (0, 0))
    sums: Floats | None = None
    returns: bool = False


Work = Callable[..., tuple[Floats, Floats | None]]


def cut(size: tuple[int, int], wanted: int) -> list[Piece]:
    """Cut a picture into about so many pieces: bands, or parts of rows of blocks."""
    width, height = size
    across, down = -(-width // BLOCK_EDGE), -(-height // BLOCK_EDGE)
    bands = _shares(down, min(wanted, down))
    parts = _shares(across, 1 if len(bands) < down else min(-(-wanted // down), across))
    return [
        Piece(
            top * across + left,
            (bottom - top - 1) * across + right - left,
            (top * BLOCK_EDGE, min(bottom * BLOCK_EDGE, height)),
            (left * BLOCK_EDGE, min(right * BLOCK_EDGE, width)),
        )
        for top, bottom in bands
        for left, right in parts
    ]


def _shares(count: int, wanted: int) -> list[tuple[int, int]]:
    """Cut a row of things into parts of about the same number."""
    ends = [count * k // wanted for k in range(wanted + 1)]
    return list(zip(ends, ends[1:], strict=False))


def pieces_for(size: tuple[int, int], workers: dict[str, int]) -> list[Piece]:
    """The pieces of a picture for some workers, of whom the numbers of threads are given."""
    pixels, threads = size[0] * size[1], max(workers.values(), default=1)
    most = pixels // (FEWEST_BLOCKS * BLOCK_EDGE**2 * threads)
    return cut(size, max(min(PIECES * len(workers), most), -(-pixels // MOST_PIXELS), 1))


def add_in_pieces(
    executor: Executor,
    work: Work,
    order: Order,
    target: tuple[Floats, Floats],
    progress: Callable[[float], None] | None,
) -> None:
    """Add samples to all of a picture by an executor.

    work : makes a piece, on a worker
    order : of no piece yet
    target : the image, and the sums so far; these are empty if nobody wants them
    """
    image, film = target
    pieces = pieces_for(order.camera.size, executor.workers)
    names = {piece: f"render {k}/{len(pieces)}" for k, piece in enumerate(pieces, 1)}
    first, end = order.samples
    jobs, done = deque[Job](), 0

    def ask(piece: Piece, begin: int, sums: Floats | None) -> None:
        last = min(end, begin // LONGEST_PASS * LONGEST_PASS + LONGEST_PASS)
        wanted = film.size > 0 or last < end
        new = replace(order, piece=piece, samples=(begin, last), sums=sums, returns=wanted)
        jobs.append(Job(names[piece], work, (new,)))

    def tick() -> None:
        if progress is not None:
            progress(done / (len(pieces) * (end - first)))

    for piece in pieces:
        ask(piece, first, piece.of(film).copy() if first > 0 else None)
    for job, (pixels, sums) in executor.run(jobs, tick):
        made: Order = job.args[0]
        done += made.samples[1] - made.samples[0]
        if film.size > 0:
            made.piece.of(film)[:] = sums
        if made.samples[1] < end:
            ask(made.piece, made.samples[1], sums)
        else:
            made.piece.of(image)[:] = pixels


def in_order(results: Iterator[tuple[int, Any]]) -> Iterator[Any]:
    """Results that come with their numbers, in the order of these."""
    early: dict[int, Any] = {}
    number = 0
    for k, result in results:
        early[k] = result
        while number in early:
            yield early.pop(number)
            number += 1
