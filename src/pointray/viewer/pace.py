"""Quality and timing of each image: this table is the viewer's whole policy.

| stage   | when                            | pixels                                     | samples      | JPEG |
|---------|---------------------------------|--------------------------------------------|--------------|------|
| moving  | less than 0.05 s after a change | all, if that allows 42 images a second;    | 1            | 80   |
|         |                                 | otherwise fewer, see SCALES                |              | (90) |
| still   | 0.05 s after the last change    | all                                        | 1            | 90   |
| refined | immediately after it            | all                                        | 2, 4, 8, ... | 94   |

Small moving images, of less than 500 rows, are compressed like still ones: the page magnifies them.
A moving image of all pixels also counts as the still one. A change of the camera or of view settings starts a moving
image and cancels the other stages between two tiles. A message with an unchanged camera has no effect.
"""

from __future__ import annotations

from typing import NamedTuple

REST = 0.05  # seconds without a change before the still image
PASS = 0.4  # longest pass of refinement in seconds, hence the longest interval between refined images
# Scale of moving images (width and height) -> its time limit in seconds. Below 0.3 a lower frame rate looks better than
# fewer pixels.
SCALES = {
    1.0: 1 / 42,
    0.75: 1 / 42,
    0.625: 1 / 42,
    0.5: 1 / 42,
    0.4375: 1 / 40,
    0.375: 1 / 36,
    0.3125: 1 / 32,
    0.25: 1 / 24,
    0.1875: 1 / 12,
    0.125: 1.0,
}
HEADROOM = 0.8  # a finer scale must fit into this fraction of its limit, so that the scale does not oscillate
ADAPT = 0.3  # weight of the newest measurement
START = 0.5  # scale of the first frame


class Stage(NamedTuple):
    """Stage of refinement of an image, with the compression of its JPEG.

    name : "moving" (perhaps reduced, one sample a pixel), "still" (one sample) or "refined" (more samples)
    quality : 1 to 100; subsampling : of the chroma: 0 none, 2 half the width and height
    """

    name: str
    quality: int  # of the JPEG
    subsampling: int  # of the JPEG's chroma: 0 none, 2 half the width and height


MOVING = Stage("moving", 80, 2)
STILL = Stage("still", 90, 0)
REFINED = Stage("refined", 94, 0)


class Pace:
    """Chooses the resolution of images while the camera moves, so that they meet their time limits."""

    def __init__(self) -> None:
        self._seconds: float | None = None  # estimated time of an image at full resolution
        self._scale = START

    def scale(self) -> float:
        """Return the resolution of the next moving image: a factor of its width and height, from 1/8 to 1."""
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
        """Record how long a moving image took. scale : factor of its width and height"""
        whole = seconds / (scale * scale)
        self._seconds = whole if self._seconds is None else self._seconds + ADAPT * (whole - self._seconds)


def next_pass(last: int, seconds: float) -> int:
    """Return how many samples per pixel the next pass of refinement adds to an image.

    They are at most twice as many as in the last pass, and take about 0.4 s at most, but at least 1.

    last : samples per pixel that the last pass added; seconds : duration of the last pass
    """
    return max(1, min(2 * last, int(last * PASS / max(seconds, 1e-9))))
