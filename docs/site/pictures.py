"""Comparison of the pictures that pages produce with the stored ones, and their replacement."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageSequence

WIDTH = 256  # of both pictures when they are compared
MEAN, EXTREME = 1.5, 24.0  # greatest mean difference and 99.5th percentile, in levels of 255
QUICK_MEAN, QUICK_EXTREME = 6.0, 60.0  # the same for pictures rendered with fewer samples, or that vary
LARGEST, QUALITY = 1600, 88  # width in pixels and WebP quality of stored pictures
SUFFIXES = ".png", ".jpg", ".webp", ".gif", ".mp4"


def find_produced(folder: Path, stem: str) -> Path | None:
    """Return the picture of a name that a page has written, None if there is none."""
    return next((path for suffix in SUFFIXES if (path := folder / f"{stem}{suffix}").exists()), None)


def compare(produced: Path, stored: Path, loosely: bool) -> str | None:
    """Return how a produced picture differs from the stored one, None if it does not."""
    if not stored.exists():
        return f"{stored.name} is not stored"
    frames = [(_load(produced, share), _load(stored, share)) for share in (0.0, 0.5)]
    for new, old in frames:
        if abs(new.shape[0] - old.shape[0]) > 2:
            return f"{produced.name} has another aspect ratio than {stored.name}"
        rows = min(len(new), len(old))
        difference = np.abs(new[:rows] - old[:rows])
        mean, extreme = float(difference.mean()), float(np.percentile(difference, 99.5))
        if mean > (QUICK_MEAN if loosely else MEAN) or extreme > (QUICK_EXTREME if loosely else EXTREME):
            return (
                f"{produced.name} differs from {stored.name}: mean {mean:.1f}, 99.5th percentile {extreme:.0f} of 255"
            )
    return None


def store(produced: Path, stored: Path) -> None:
    """Replace a stored picture by a produced one. Animations are copied, films are not stored."""
    stored.parent.mkdir(parents=True, exist_ok=True)
    image = Image.open(produced)
    if getattr(image, "n_frames", 1) > 1:
        stored.write_bytes(produced.read_bytes())
        return
    if image.width > LARGEST:
        image = image.resize((LARGEST, round(image.height * LARGEST / image.width)), Image.Resampling.LANCZOS)
    image.save(stored, "WEBP", quality=QUALITY, method=6)


def _load(path: Path, share: float) -> np.ndarray:
    """Return a picture over white, or the frame at a fraction of an animation, (h, WIDTH, 3) float."""
    image = Image.open(path)
    if frames := getattr(image, "n_frames", 1) - 1:
        image = ImageSequence.all_frames(image)[round(frames * share)]
    image = image.convert("RGBA")
    over = Image.alpha_composite(Image.new("RGBA", image.size, "white"), image).convert("RGB")
    height = max(1, round(over.height * WIDTH / over.width))
    return np.asarray(over.resize((WIDTH, height), Image.Resampling.BOX), float)
