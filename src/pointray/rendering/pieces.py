"""Rendering of an image in pieces of whole blocks, on the workers of a cluster.

Samples and their order of summation are those of an undivided image: an order carries a range of sample indices and the
sums so far, and ends only where sums are rounded (`film.round_sums`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from ..base.arrays import Floats
from ..base.executor import Executor, Job
from .camera import Camera
from .film import LONGEST_PASS
from .integrate import BLOCK_EDGE
from .settings import Settings

PIECES = 8  # pieces a worker, for load balance
FEWEST_BLOCKS = 4  # minimum blocks of a piece, for each thread of a worker
MOST_PIXELS = 1 << 16  # pixels of a piece, or twice that with long rows, as a message holds a piece with its sums


class Piece(NamedTuple):
    """Part of an image that one job renders: consecutive blocks of 16 x 16 pixels.

    block, blocks : number of the first block, row by row in the image, and count of blocks
    rows, columns : ranges (begin, end) of rows and of columns of pixels that the blocks cover
    """

    block: int
    blocks: int
    rows: tuple[int, int]
    columns: tuple[int, int]

    def of(self, image: Floats) -> Floats:
        """Return this piece of an array of the whole image, (height, width, ...), as a view."""
        return image[slice(*self.rows), slice(*self.columns)]


@dataclass(frozen=True)
class Order:
    """Request to a worker: add samples to a piece of an image.

    Attributes
    ----------
    camera, settings
        Of the whole image.
    background : RGB and alpha, or None
        None: the scene's.
    samples : (int, int)
        Range of sample indices.
    piece : Piece
        The pixels to render.
    sums : (h, w, k) float32, or None
        Sums of earlier samples; None: no earlier samples.
    returns : bool
        Whether to return the sums.
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
    """Divide an image into about `wanted` pieces of whole blocks: bands of full width, or parts of rows of blocks.

    size : width and height in pixels
    """
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
    """Divide range(count) into `wanted` ranges of similar length."""
    ends = [count * k // wanted for k in range(wanted + 1)]
    return list(zip(ends, ends[1:], strict=False))


def pieces_for(size: tuple[int, int], workers: dict[str, int]) -> list[Piece]:
    """Return the pieces of an image for workers: several a worker for load balance, small enough for a message.

    size : width and height in pixels; workers : number of threads of each worker, by address
    """
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
    """Add samples to a whole image and its film (sums over samples), piece by piece, with jobs for an executor.

    work : renders a piece on a worker; takes the snapshot, an order, a number of threads and a progress callback
    order : camera, settings, background and range of samples of the image; its piece is ignored
    target : (image, film), where the results are stored: (h, w, 4) RGB and alpha, and (h, w, k) sums or
        empty, which is not updated
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
    """Yield results, which arrive as (number, result) in any order, in the order of their numbers 0, 1, 2 and so on."""
    early: dict[int, Any] = {}
    number = 0
    for k, result in results:
        early[k] = result
        while number in early:
            yield early.pop(number)
            number += 1
