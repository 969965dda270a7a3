"""How good the picture is, and when: the whole policy of the viewer is in this table.

| stage   | when                                   | pixels                                | samples      | JPEG |
|---------|----------------------------------------|---------------------------------------|--------------|------|
| moving  | something changed less than 0.12 s ago | all, if that makes 30 frames a second | 1            | 80   |
|         |                                        | half across and down, if that makes   |              |      |
|         |                                        | 18; else fewer, see SCALES            |              |      |
| still   | 0.12 s later                           | all                                   | 1            | 90   |
| refined | at once after it                       | all                                   | 2, 4, 8, ... | 94   |

A moving picture of all pixels counts as the still one. What has changed, camera or view settings, makes it moving
again; that ends the others between two tiles. A camera message with the same camera changes nothing.
"""

from __future__ import annotations

from typing import NamedTuple

REST = 0.12  # seconds without a change, then it is still
PASS = 0.4  # seconds that a pass of refinement may take: so often the picture gets better
# Shares of the view's width and height that moving pictures have, and the seconds that a picture may take then: fewer
# pixels than half across and down are worse to look at than fewer pictures.
SCALES = {1.0: 1 / 30, 0.75: 1 / 28, 0.625: 1 / 25, 0.5: 1 / 18, 0.375: 1 / 13, 0.25: 1 / 10, 0.1875: 1 / 8, 0.125: 1.0}
ROOM = 0.8  # of these seconds: a finer scale must fit into that, so that the scale does not swing
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
        fitting = [
            scale
            for scale, allowed in SCALES.items()
            if self._seconds * scale * scale <= allowed * (ROOM if scale > self._scale else 1.0)
        ]
        self._scale = max(fitting, default=min(SCALES))
        return self._scale

    def took(self, seconds: float, scale: float) -> None:
        """A moving picture of a scale took so long."""
        whole = seconds / (scale * scale)
        self._seconds = whole if self._seconds is None else self._seconds + ADAPT * (whole - self._seconds)


def next_pass(last: int, seconds: float) -> int:
    """How many samples the next pass of refinement adds, if the last one added so many in so many seconds."""
    return max(1, min(2 * last, int(last * PASS / max(seconds, 1e-9))))
