"""How good the picture is, and when: the whole policy of the viewer is in this table.

| stage   | when                                        | pixels                        | samples       | JPEG |
|---------|---------------------------------------------|-------------------------------|---------------|------|
| moving  | something changed less than 0.12 s ago      | as many as 25 frames a second | 1             | 80   |
| still   | 0.12 s later                                | all                           | 1             | 90   |
| refined | at once after it                            | all                           | 2, 4, 8, ...  | 94   |

What has changed, camera or looks, makes it moving again; that ends the others between two tiles. A camera message with
the same camera changes nothing.
"""

from __future__ import annotations

from typing import NamedTuple

REST = 0.12  # seconds without a change, then it is still
FRAME = 1 / 25  # seconds that a frame may take while something moves
PASS = 0.4  # seconds that a pass of refinement may take: so often the picture gets better
# Shares of the view's width and height: moving pictures are one of these.
SCALES = (1.0, 0.75, 0.625, 0.5, 0.375, 0.25, 0.1875, 0.125)
ROOM = 0.8  # of a frame's time: a finer scale must fit into it, so that the scale does not swing
ADAPT = 0.3  # weight of the newest measurement
START = 0.5  # scale of the first frame


class Stage(NamedTuple):
    """One row of the table."""

    name: str
    quality: int  # of the JPEG
    subsampling: int  # of its colours: 0 none, 2 half as many across and down


MOVING = Stage("moving", 80, 2)
STILL = Stage("still", 90, 0)
REFINED = Stage("refined", 94, 0)


class Pace:
    """Chooses the scale of moving pictures so that they keep up."""

    def __init__(self) -> None:
        self._seconds: float | None = None  # a frame of the whole view would take
        self._scale = START

    def scale(self) -> float:
        """For the next moving picture."""
        if self._seconds is None:
            return self._scale
        fitting = [s for s in SCALES if self._seconds * s * s <= FRAME * (ROOM if s > self._scale else 1.0)]
        self._scale = max(fitting, default=SCALES[-1])
        return self._scale

    def took(self, seconds: float, scale: float) -> None:
        """A moving picture of a scale took so long."""
        whole = seconds / (scale * scale)
        self._seconds = whole if self._seconds is None else self._seconds + ADAPT * (whole - self._seconds)


def next_pass(last: int, seconds: float) -> int:
    """How many samples the next pass of refinement adds, if the last one added so many in so many seconds."""
    return max(1, min(2 * last, int(last * PASS / max(seconds, 1e-9))))
