"""Fixtures that all tests share, and their markers."""

from __future__ import annotations

import gc
import importlib
import json
import os
import signal
import zlib
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path

import hypothesis
import numpy as np
import pytest
import typer.main
from filelock import FileLock

from helpers.places import TESTS
from native import signatures
from pointray.base.dependencies import key_of
from pointray.engine import jit

# A background job of a shell ignores Ctrl-C, and so does all that it starts, but tests send it.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Each run tries the same examples.
hypothesis.settings.register_profile("repeatable", derandomize=True, database=None)
hypothesis.settings.load_profile("repeatable")

MOST_KEPT = 200_000  # points of models that are kept on disk


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--seed", type=int, default=0, help="Seed that every test's own seed is combined with (0)")


def pytest_collection_finish() -> None:
    """Exclude modules and tests, which stay to the end, from garbage collection."""
    gc.freeze()


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Random generator of one test, seeded by its name: the data do not depend on other tests or their order."""
    return np.random.default_rng([request.config.getoption("seed"), zlib.crc32(request.node.name.encode())])


@pytest.fixture(scope="session", autouse=True)
def one_signature_a_kernel(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Check that no test calls a kernel with a second type of array: for users it would be compiled again.

    Tests run in several processes. Each leaves its signatures in a file; the last one sees all.
    """
    yield
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    recorded = signatures.recorded()["kernels"]
    compiled = {name: k.signatures for name, k in jit.KERNELS.items() if name.startswith("pointray.") and k.signatures}
    for name, (types, *_) in compiled.items():  # what the library of kernels is built from
        assert [signatures.described(kind, {}) for kind in types] == recorded.get(name), f"{name}: see CONTRIBUTING.md"
    own = {name: [str(signature) for signature in kernel.signatures] for name, kernel in jit.KERNELS.items()}
    (folder / f"signatures-{os.getpid()}.json").write_text(json.dumps(own))
    found: dict[str, set[str]] = {}
    for file in folder.glob("signatures-*.json"):
        for name, texts in json.loads(file.read_text()).items():
            found.setdefault(name, set()).update(texts)
    assert {name: texts for name, texts in found.items() if len(texts) > 1} == {}


@pytest.fixture(scope="session", autouse=True)
def no_models_are_kept() -> Iterator[None]:
    """Prevent commands from storing models in the user's cache, except in tests of the cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pointray.model.model_cache.WORTH", 10**12)
        yield


@pytest.fixture(scope="session", autouse=True)
def commands_made_once() -> Iterator[None]:
    """Build the command line once: typer does so at each call, which takes most of the time of a short command."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(typer.main, "get_command", lru_cache(typer.main.get_command))
        yield


@pytest.fixture(scope="session", autouse=True)
def models_made_once(pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Make each procedural model once for all test processes, and keep it in pytest's cache: the statue takes 8 s.

    A test that makes the same one twice calls `sample` as it was imported, see
    `tests/unit/procedural_models/test_procedural_models.py`.
    """
    module = importlib.import_module("pointray.procedural_models")
    cache = getattr(pytestconfig, "cache", None)  # absent with -p no:cacheprovider
    key = f"procedural-{key_of([Path(module.__file__)])}"
    folder = tmp_path_factory.mktemp(key) if cache is None else cache.mkdir(key)
    sample = module.sample
    made = lru_cache(maxsize=100, typed=True)(kept_in(folder, sample))

    def copied(name: object, n: object, seed: object) -> tuple[np.ndarray, ...]:
        valid = type(name) is str and name in module.NAMES and type(n) is int and 0 < n <= MOST_KEPT
        valid = valid and type(seed) is int and 0 <= seed < 2**31
        return tuple(array.copy() for array in (made if valid else sample)(name, n, seed))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "mesh", lru_cache(kept_in(folder, module.mesh)))
        patch.setattr(module, "sample", copied)
        yield


def kept_in(folder: Path, function: Callable[..., tuple[np.ndarray, ...]]) -> Callable[..., tuple[np.ndarray, ...]]:
    """Return a function with the same results, which are computed once and read from a folder from then on."""

    def call(*arguments: object) -> tuple[np.ndarray, ...]:
        file = folder / "-".join(map(str, (function.__name__, *arguments, "arrays.npz")))
        with FileLock(f"{file}.lock"):
            if not file.exists():
                unfinished = file.with_suffix(".unfinished.npz")
                np.savez(unfinished, *function(*arguments))
                unfinished.replace(file)
        with np.load(file) as arrays:
            return tuple(arrays[name] for name in arrays)

    return call


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests by their folder, and put those that take minutes first: at the end one process would do the last."""
    for item in items:
        for marker in ("browser", "cluster"):
            if TESTS / marker in item.path.parents:
                item.add_marker(marker)
    items.sort(key=lambda item: item.get_closest_marker("long") is None)
