"""Models of scans that were built before, in the user's cache: the next time they are mapped at once.

A model is known by its files (path, size, time of the last change), by how they were read and built, and by the
package's sources. It is written beside and renamed, so that processes never see half of one; the least recently used
ones go when all together are too large.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import platformdirs

from ..base.atomic_write import replacing, sweep
from ..base.dependencies import ROOT, key_of
from ..base.warning_log import heard, warn
from .model import Model
from .model_file import SAVED

FOLDER = "models"
MOST_BYTES = 16 << 30  # of all models together, but never more than MOST_SHARE of the disk's free space
MOST_SHARE = 0.5
WORTH = 50_000  # points from which a model is kept: smaller ones are built in less than half a second
SETTLED = 2.0  # seconds since a file's last change: one that changes again within its clock's tick looks unchanged


@dataclass(frozen=True)
class Entry:
    """The place of a model in the cache.

    Attributes
    ----------
    path : path
        The saved model; beside it lies what `describe` tells, as JSON.
    about : dict
        What the model is made of, in values of JSON.
    """

    path: Path
    about: Mapping[str, Any]

    def load(self) -> Model | None:
        """The model; None if it is not there, or is damaged. Notes that building it gave are given again."""
        if not self.path.exists():
            return None
        try:
            model = Model.load(self.path)
            os.utime(self.path)  # it is the most recently used one now
        except (OSError, ValueError):
            _remove(self.path)
            return None
        for note in _description(self.path).get("notes", []):
            warn(str(note), stacklevel=2)
        return model

    def store(self, model: Model, notes: Sequence[str] = (), progress: Callable[[float], None] | None = None) -> bool:
        """Keep a model for the next time; returns whether that was done. Errors of the disk are no errors here."""
        if len(model.points) < WORTH or not self._settled() or model.nbytes > _limit():
            return False
        description = {**self.about, "notes": list(notes), "points": len(model.points)}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(self.path.with_suffix(".json")) as file:
                file.write(json.dumps(description).encode())
            model.save(self.path, progress)
            _prune(keep=self.path)
        except OSError:
            return False
        return True

    def _settled(self) -> bool:
        """Whether the files are as they were, and were not written just now."""
        with suppress(OSError):
            files = [Path(facts["path"]) for facts in self.about["files"]]
            return _facts_of(files) == self.about["files"] and all(
                time.time() - file.stat().st_mtime > SETTLED for file in files
            )
        return False


def entry_of(files: Sequence[Path], made: Mapping[str, Any]) -> Entry:
    """The place of the model of some files.

    Parameters
    ----------
    files : sequence of path
    made : dict
        How they are read and built, in values of JSON.
    """
    about = {"files": _facts_of(files), "made": dict(made)}
    text = json.dumps([about, source_key()], sort_keys=True)
    return Entry(folder() / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}{SAVED}", about)


def built(build: Callable[[], Model]) -> tuple[Model, list[str]]:
    """A model that is built, and the notes that this gave, which are given as usual."""
    with heard() as notes:
        model = build()
    for note in notes:
        warn(note, stacklevel=2)
    return model, notes


def folder() -> Path:
    """Where models are kept: in POINTRAY_CACHE, else in the user's cache."""
    base = os.environ.get("POINTRAY_CACHE") or platformdirs.user_cache_dir("pointray", appauthor=False)
    return Path(base) / FOLDER


def describe() -> list[dict[str, Any]]:
    """The models that are kept, the most recently used first: path, bytes, used (time), and what each is made of."""
    found = []
    for path in _by_age():
        with suppress(OSError):
            facts = path.stat()
            found.append({"path": path, "bytes": facts.st_size, "used": facts.st_mtime, **_description(path)})
    return found[::-1]


def clear() -> tuple[int, int]:
    """Remove all models; returns their number and bytes."""
    models = describe()
    sweep(folder())
    for model in models:
        _remove(model["path"])
    for path in folder().glob("*.json"):
        with suppress(OSError):
            path.unlink()
    return len(models), sum(model["bytes"] for model in models)


@cache
def source_key() -> str:
    """Return a hash of the sources that decide what a model is.

    These are `model/model.py`, all of `cloud/` and `io/`, whose formats are loaded by name, and what these import.
    """
    return key_of(
        [ROOT / "model/model.py", *(ROOT / "cloud").rglob("*.py"), *(ROOT / "io").rglob("*.py")], deferred=True
    )


def _facts_of(files: Sequence[Path]) -> list[dict[str, Any]]:
    facts = [(file.resolve(), file.stat()) for file in files]
    return [{"path": str(path), "bytes": stat.st_size, "written": stat.st_mtime_ns} for path, stat in facts]


def _description(path: Path) -> dict[str, Any]:
    """What lies beside a model; empty if it is damaged."""
    with suppress(OSError, ValueError, RecursionError):  # thousands of brackets
        found = json.loads(path.with_suffix(".json").read_bytes())
        if isinstance(found, dict) and _is_sound(found):
            return found
    return {}


def _is_sound(description: dict[str, Any]) -> bool:
    """Whether all that is used of a description has its type."""
    files, notes = description.get("files"), description.get("notes")
    return (
        isinstance(files, list)
        and all(isinstance(file, dict) and isinstance(file.get("path"), str) for file in files)
        and isinstance(notes, list)
        and type(description.get("points")) is int
    )


def _by_age() -> list[Path]:
    """The models, the least recently used first."""
    ages = []
    for path in folder().glob(f"*{SAVED}"):
        with suppress(OSError):
            if not path.name.startswith("."):
                ages.append((path.stat().st_mtime, path))
    return [path for _, path in sorted(ages)]


def _limit() -> float:
    """Bytes that all models together may take."""
    place = folder()
    while not place.exists():
        place = place.parent
    used = sum(model["bytes"] for model in describe())
    return min(MOST_BYTES, MOST_SHARE * (shutil.disk_usage(place).free + used))


def _prune(keep: Path) -> None:
    """Remove the least recently used models until the others fit, and those of other versions of the sources."""
    limit, paths = _limit(), _by_age()
    sizes = {path: path.stat().st_size for path in paths if path.exists()}
    total = sum(sizes.values())
    for path in paths:
        if total <= limit:
            return
        if path != keep:
            total -= sizes.get(path, 0)
            _remove(path)


def _remove(path: Path) -> None:
    """Remove a model and what lies beside it; one that another process has mapped stays readable there."""
    for one in (path, path.with_suffix(".json")):
        with suppress(OSError):
            one.unlink()
