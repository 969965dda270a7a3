"""Files of KITTI and nuScenes."""

import numpy as np

N = 80  # a file of N rows of 16 bytes, or of 64 of 20, has the same size

XYZ = np.random.default_rng(9).normal(size=(N, 3)).astype(np.float32) * 20

REFLECTANCE = np.random.default_rng(10).random((N, 1)).astype(np.float32)

RINGS = (np.arange(N)[:, None] % 32).astype(np.float32)


def save(path, *columns):
    np.concatenate(columns, axis=1).tofile(path)
    return path
