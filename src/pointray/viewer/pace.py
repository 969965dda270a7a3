"""The quality and the time of each picture: this table is the viewer's whole policy.

| stage   | when                                   | pixels                                | samples      | JPEG |
|---------|----------------------------------------|---------------------------------------|--------------|------|
| moving  | something changed less than 0.12 s ago | all, if that makes 30 frames a second | 1            | 80   |
|         |                                        | half across and down, if that makes   |              |      |
|         |                                        | 18; else fewer, see SCALES            |              |      |
| still   | 0.12 s later                           | all                                   | 1            | 90   |
| refined | at once after it                       | all                                   | 2, 4, 8, ... | 94   |

A moving picture of all pixels also counts as the still one. A change of camera or view settings starts a moving
picture; the other stages are cancelled between two tiles. A camera message with the same camera changes nothing.
"""

from __future__ import annotations

from typing import NamedTuple

REST = 0.12  # seconds without a change before a picture is still
PASS = 0.4  # limit in seconds for a pass of refinement: the picture gets better this often
# Shares of the view's width and height for moving pictures, and the time limit of each in seconds: fewer pixels than
# half across and down look worse than fewer pictures.
SCALES = {1.0: 1 / 30, 0.75: 1 / 28, 0.625: 1 / 25, 0.5: 1 / 18, 0.375: 1 / 13, 0.25: 1 / 10, 0.1875: 1 / 8, 0.125: 1.0}
HEADROOM = 0.8  # share of these seconds: a finer scale must fit into it, so that the scale does not oscillate
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
    """Chooses the scale of moving pictures so that they are drawn in time."""

    def __init__(self) -> None:
        self._seconds: float | None = None  # time of a frame of the whole view
        self._scale = START

    def scale(self) -> float:
        """The scale for the next moving picture."""
        if self._seconds is None:
            return self._scale
        fitting = [
            scale
            for scale, allowed in SCALES.items()
            if self._seconds * scale * scale <= allowed * (HEADROOM if scale > self._scale else 1.0)
        ]
        self._scale = max(fitting, default=min(SCALES))
        return self._scale

    def record(self, seconds: float, scale: float) -> None:
        """Record how long a moving picture of a given scale took."""
        whole = seconds / (scale * scale)
        self._seconds = whole if self._seconds is None else self._seconds + ADAPT * (whole - self._seconds)


def next_pass(last: int, seconds: float) -> int:
    """The number of samples for the next pass of refinement, given the number and the time of the last pass."""
    return max(1, min(2 * last, int(last * PASS / max(seconds, 1e-9))))
