"""What several tests share."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pointray import jit

# A shell's job in the background ignores Ctrl-C, and all that it starts does too; tests send it.
signal.signal(signal.SIGINT, signal.default_int_handler)

MODELS = Path(__file__).resolve().parents[2] / "shared" / "models"


@pytest.fixture(scope="session", autouse=True)
def one_signature_a_kernel() -> Iterator[None]:
    """A second type of array would compile a kernel again, in front of a user: no test may have brought one."""
    yield
    many = {name: kernel.signatures for name, kernel in jit.KERNELS.items() if len(kernel.signatures) > 1}
    assert not many


def shared_model(name: str) -> Path:
    """Path of a real scan, such as 'points/stanford_bunny.ply'; skips the test where it is not to be had."""
    path = MODELS / name
    if not path.exists():
        pytest.skip(f"the scan {name} is not here")
    return path


def sphere_points(n: int, seed: int = 0) -> np.ndarray:
    """Random points of the unit sphere, (n, 3) float32."""
    rows = np.random.default_rng(seed).normal(size=(n, 3))
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)
