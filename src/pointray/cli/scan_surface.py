"""The surface of a scan, from the options --surface, --samples, --radius-scale, --smooth and --scatter."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..base.arguments import check_positive
from ..base.choices import AUTO
from .scan_files import is_saved


def surface_of(options: dict[str, Any]) -> dict[str, Any]:
    """The parameters of `Model` from the options of a scan's surface; a wrong option raises ValueError."""
    check_positive(options["radius_scale"], "--radius-scale")
    check_positive(options["scatter_size"], "--scatter-size")
    return {**options, "smooth": smooth_of(str(options["smooth"]))}


def as_option(error: ValueError) -> str:
    """The message of an error of `Model`, with the option in place of the parameter that it begins with."""
    text = str(error)
    return f"--{text}" if text.startswith("scatter: ") else text


def check_saved(file: Path, is_plain: bool) -> None:
    """Raise ValueError if options ask for another surface or other normals than a saved model has."""
    if is_saved(file) and not is_plain:
        raise ValueError(
            f"{file}: --surface, --samples, --radius-scale, --smooth, --scatter, --scatter-size and --normals are part "
            "of a saved model"
        )


def smooth_of(text: str) -> str | float:
    """Parse "auto" or a number from 0."""
    from ..cloud.denoising.smooth import check_sigma

    if text == AUTO:
        return text
    try:
        return check_sigma(float(text), "--smooth")
    except ValueError:
        raise ValueError(f"--smooth must be auto or a finite number from 0, not {text!r}") from None
