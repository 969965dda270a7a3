"""Points as a file has them, before they are shown: whose normals are used, and what is said of their flaws."""

from __future__ import annotations

import warnings

import numpy as np

from ..arguments import check_choice
from ..data import Points
from ..progress import Progress
from .normals.estimate import estimate_normals
from .normals.given import NormalsCheck, compare_normals
from .rounding import find_rounding

WISHES = ("auto", "file", "fit")  # whose normals are used
KEEP = "--normals file"  # what a user says to keep those of the file
CLEAR = 0.5  # cosine from which a file's normal tells a sign
AGREED = 0.5  # how much more of them must say the opposite than agree, for the signs to be turned


def trusted(points: Points, wish: str = "auto", keep: str = KEEP, progress: Progress | None = None) -> Points:
    """The points with the normals that are wished for; warns of wrong normals and of rounded coordinates.

    Parameters
    ----------
    points : Points
    wish : {"auto", "file", "fit"}
        "auto": the normals they have, unless these are wrong; "file": those they have; "fit": none, so that `Model`
        estimates them.
    keep : str
        What a user says to keep those there are.
    progress : callable, optional
        Of estimating others.

    Raises
    ------
    ValueError
        If those of the file are wished for and there are none.
    """
    points, wrong = judged(points, wish, keep)
    return replaced(points, progress) if wrong else points


def judged(points: Points, wish: str = "auto", keep: str = KEEP, name: str = "") -> tuple[Points, bool]:
    """The same points, perhaps without normals, and whether `replaced` has to be asked for others; warns likewise.

    name : of the file, where there are several.
    """
    check_wish(points, wish, keep)
    prefix = f"{name}: " if name else ""
    steps, rounded = find_rounding(points)
    if rounded:
        warnings.warn(prefix + rounded, stacklevel=3)
    if wish == "fit":
        return points.with_normals(None), False
    if wish == "file":
        return points, False
    found = compare_normals(points, max(steps))
    if found.wrong:
        warnings.warn(f"{prefix}{told(found)}: fitted ones are used ({keep} keeps them)", stacklevel=3)
    return points, found.wrong


def check_wish(points: Points, wish: str, keep: str = KEEP) -> None:
    """ValueError if normals are wished for that there are none of."""
    check_choice(wish, "normals", WISHES)
    if wish == "file" and points.normals is None:
        raise ValueError(f"{keep}: there are no normals in the file")


def told(found: NormalsCheck) -> str:
    """What is said of wrong normals."""
    return f"normals in the file are a median of {found.angle:.0f} degrees off the surface"


def replaced(points: Points, progress: Progress | None = None) -> Points:
    """With fitted normals; where the old ones clearly look to the other side, all of them are turned."""
    fitted = estimate_normals(points, progress=progress).normals
    assert fitted is not None and points.normals is not None
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.linalg.norm(points.normals, axis=1)
        side = np.einsum("ij,ij->i", fitted, points.normals)
        clear = np.abs(side) > CLEAR * length
    turned = bool(clear.any()) and float(np.sign(side[clear]).mean()) < -AGREED
    return points.with_normals(-fitted if turned else fitted)
