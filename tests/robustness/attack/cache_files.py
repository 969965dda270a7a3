"""The cache of models with damaged files: entries, their neighbours, and foreign files in the folder.

A damaged entry is removed and never raises an error in the caller. The listing of the cache works, and the
next model is kept.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import time
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any

import numpy as np

import pointray as pr
from attack import Attack, WrongError
from attack.model_files import JSONS, anything
from attack.mutate import Rng, corrupt, pick
from helpers.model_bytes import split
from pointray.cli import execute
from pointray.model import model_cache

ROWS = 300


def change_json(rng: Rng, data: bytes) -> bytes:
    """A description with other values, or damaged."""
    kind = rng.random()
    if kind < 0.3:
        return corrupt(rng, data)
    if kind < 0.4:
        return json.dumps(pick(rng, JSONS)).encode()
    if kind < 0.45:
        return b"[" * 100_000
    about = json.loads(data)
    parent: Any = pick(rng, (about, about, about["files"], about["files"][0], about["made"]))
    key = pick(rng, list(parent)) if isinstance(parent, dict) else 0
    parent[key] = pick(rng, JSONS)
    return json.dumps(about).encode()


def strange(rng: Rng, entry: Path) -> None:
    """Replace files of the cache with other objects, or add foreign ones."""
    path = pick(rng, (entry, entry.with_suffix(".json"), entry.with_name(f"{'0' * 32}{entry.suffix}")))
    path.unlink(missing_ok=True)
    kind = int(rng.integers(4))
    if kind == 0:
        path.mkdir()
    elif kind == 1:
        path.symlink_to(entry.parent / "nothing")
    elif kind == 2:
        path.symlink_to(path)
    else:
        path.write_bytes(b"")


def listing(*arguments: str) -> None:
    """The command about the cache; WrongError if it fails."""
    output = io.StringIO()
    with redirect_stdout(output), redirect_stderr(output):
        status = execute(["cache", *arguments])
    if status != 0:
        raise WrongError(f"cache {' '.join(arguments)}: {output.getvalue()[-200:]}")


def begin(folder: Path) -> Attack:
    """Mutated entries of the cache."""
    os.environ["POINTRAY_CACHE"], model_cache.WORTH = str(folder / "cache"), 10
    scan = folder / "scan.ply"
    pr.write(scan, pr.procedural("sphere", ROWS))
    os.utime(scan, (time.time() - 10,) * 2)
    model = pr.Model(pr.read(scan))
    entry = model_cache.entry_of([scan], {"surface": None})
    beside = entry.path.with_suffix(".json")
    if not entry.store(model, ["a note"]):
        raise RuntimeError("the cache keeps nothing")
    whole, about = entry.path.read_bytes(), beside.read_bytes()
    parts = split(whole)
    listing()

    def damage(rng: Rng) -> None:
        changes: list[Callable[[], object]] = [
            lambda: entry.path.write_bytes(corrupt(rng, whole)),
            lambda: entry.path.write_bytes(anything(rng, parts)),
            lambda: entry.path.write_bytes(whole[: int(rng.random() * len(whole))]),
            lambda: beside.write_bytes(change_json(rng, about)),
            lambda: beside.write_bytes(change_json(rng, about)),
            lambda: strange(rng, entry.path),
        ]
        pick(rng, changes)()

    def attack(rng: Rng, index: int) -> bool:
        shutil.rmtree(entry.path.parent, ignore_errors=True)
        entry.path.parent.mkdir(parents=True)
        entry.path.write_bytes(whole)
        beside.write_bytes(about)
        damage(rng)
        listing(*pick(rng, ([], ["--json"])))
        found = entry.load()
        if found is None and entry.path.is_file():
            raise WrongError("a damaged entry stays")
        if found is not None and len(found.radii) != len(found.points):
            raise WrongError("a model with other radii than points")
        kept = entry.store(model)
        with suppress(OSError):
            kept = kept and entry.path.read_bytes() == whole
        if not kept and not any(path.is_dir() for path in (entry.path, beside)):
            raise WrongError("the next model is not kept")
        if rng.random() < 0.2:
            listing("--clear")
        return found is not None

    np.seterr(all="ignore")
    return attack
