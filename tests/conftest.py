"""Fixtures and helpers of several tests."""

from __future__ import annotations

import importlib
import signal
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from pointray import jit

# A background job of a shell ignores Ctrl-C, and so does all that it starts, but tests send it.
signal.signal(signal.SIGINT, signal.default_int_handler)

MODELS = Path(__file__).resolve().parents[2] / "shared" / "models"


@pytest.fixture(scope="session", autouse=True)
def one_signature_a_kernel() -> Iterator[None]:
    """No kernel has two signatures: a second type of array would compile it again, while a user waits."""
    yield
    many = {name: kernel.signatures for name, kernel in jit.KERNELS.items() if len(kernel.signatures) > 1}
    assert not many


@pytest.fixture(scope="session", autouse=True)
def models_made_once() -> Iterator[None]:
    """Procedural models are made once a session and copied: making them took half of the time of all tests."""
    module = importlib.import_module("pointray.points.procedural")
    sample = module.sample
    made = lru_cache(maxsize=100, typed=True)(sample)

    def copied(name: object, n: object, seed: object) -> tuple[np.ndarray, ...]:
        valid = isinstance(name, str) and isinstance(n, int) and isinstance(seed, int)
        return tuple(array.copy() for array in (made if valid else sample)(name, n, seed))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "sample", copied)
        yield


def long(*values: object) -> object:
    """A case of a test for `make long`."""
    return pytest.param(*values, marks=pytest.mark.long)


def shared_model(name: str) -> Path:
    """Path of a real scan, such as 'points/stanford_bunny.ply'; skips the test if it is absent."""
    path = MODELS / name
    if not path.exists():
        pytest.skip(f"the scan {name} is not here")
    return path


def sphere_points(n: int, seed: int = 0) -> np.ndarray:
    """Random points of the unit sphere, (n, 3) float32."""
    rows = np.random.default_rng(seed).normal(size=(n, 3))
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)
