"""Validation of points from a file: which normals are used, and which warnings are given."""

from __future__ import annotations

import numpy as np

from ...base.arguments import check_choice
from ...base.choices import NORMALS
from ...base.progress import StageProgress
from ...base.warning_log import warn
from ..points import Points
from ..rounding import find_rounding
from .comparison import NormalsCheck, compare_normals
from .estimate import estimate_normals
from .stations import eyes_of

KEEP = "--normals file"  # option that keeps the file's normals
CLEAR = 0.5  # cosine from which a file's normal decides a sign
AGREED = 0.5  # refitted normals are inverted if opposite signs outweigh equal ones by more than this share


def select_normals(
    points: Points, choice: str = "auto", keep: str = KEEP, progress: StageProgress | None = None
) -> Points:
    """Select the normals of a file, or none; warn if the file's are wrong, or its coordinates rounded.

    Parameters
    ----------
    points : Points
    choice : {"auto", "file", "fit"}
        "auto": the points' own normals, unless they are wrong, then fitted ones; "file": their own normals; "fit":
        none, so that `Model` estimates them.
    keep : str
        Option that keeps the file's normals, for messages.
    progress : callable, optional
        Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

    Returns
    -------
    Points

    Raises
    ------
    ValueError
        If the file's normals are requested but missing.
    """
    points, wrong = validate_normals(points, choice, keep)
    return refit_normals(points, progress) if wrong else points


def validate_normals(points: Points, choice: str = "auto", keep: str = KEEP) -> tuple[Points, bool]:
    """Check the normals of a file; warn if they are wrong, or the coordinates rounded.

    Returns the points, without normals if `choice` is "fit", and whether their normals are wrong and must be refitted.

    choice : "auto", "file" (own normals, not checked) or "fit" (no normals)
    keep : option that keeps the file's normals, for messages
    """
    check_normals_choice(points, choice, keep)
    steps, rounded = find_rounding(points)
    if rounded:
        warn(rounded, stacklevel=3)
    if choice == "fit":
        return points.with_normals(None), False
    if choice == "file":
        return points, False
    found = compare_normals(points, max(steps))
    if found.wrong:
        warn(f"{describe_normals(found)}: replaced by fitted normals ({keep} keeps them)", stacklevel=3)
    return points, found.wrong


def check_normals_choice(points: Points, choice: str, keep: str = KEEP) -> None:
    """Raise a ValueError if `choice` is invalid, or is "file" and the points have no normals.

    choice : "auto", "file" or "fit"
    keep : option that keeps the file's normals, for the message
    """
    check_choice(choice, "normals", NORMALS)
    if choice == "file" and points.normals is None:
        raise ValueError(f"{keep}: the file has no normals")


def describe_normals(found: NormalsCheck) -> str:
    """Return a warning about wrong normals, with their angle to the surface from the result of `check_normals`."""
    return f"normals in the file deviate from the surface by {found.angle:.0f} degrees (median)"


def refit_normals(points: Points, progress: StageProgress | None = None) -> Points:
    """Replace normals by fitted ones; if the old ones clearly face the other way, all new ones are inverted.

    With known scanner positions none are inverted.
    """
    fitted = estimate_normals(points, progress=progress).normals
    assert fitted is not None and points.normals is not None
    if eyes_of(points) is not None:
        return points.with_normals(fitted)
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.linalg.norm(points.normals, axis=1)
        side = np.einsum("ij,ij->i", fitted, points.normals)
        clear = np.abs(side) > CLEAR * length
    turned = bool(clear.any()) and float(np.sign(side[clear]).mean()) < -AGREED
    return points.with_normals(-fitted if turned else fitted)
