"""Depth images: PNG of 16 bits and arrays."""

import numpy as np
from PIL import Image

STEPS = np.random.default_rng(3).integers(0, 5000, (60, 80)).astype(np.uint16)

STEPS[:3] = 0


def save(path, picture):
    if path.suffix == ".png":
        Image.fromarray(picture).save(path)
    else:
        np.save(path, picture)
    return path


FLOATS = (STEPS / 1000).astype(np.float32)

FLOATS[10] = np.nan

FLOATS[11, :5] = np.inf

FLOATS[12, :5] = -1
