"""Cache of models in the user's cache folder: the next start maps the prepared model.

The key of a model consists of its files (path, size, modification time; for remote ones the URL and the version on the
server), how they were read and built, and the package's sources. Models are written to a temporary file and renamed, so
that processes never see half of one; the least recently used ones are removed when the cache is too large.
"""

from __future__ import annotations

import hashlib
import inspect
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
from ..base.dependencies import key_of
from ..base.progress import StageProgress
from ..base.warning_log import collect_warnings, warn
from ..cloud.normals.validation import select_normals
from ..cloud.outliers import without_strays
from ..io.files import read
from ..io.inputs import stamp
from ..io.known_formats import format_files
from ..io.remote.remote_file import Location, RemoteFile
from .model import Model
from .model_file import SAVED

FOLDER = "models"
MOST_BYTES = 16 << 30  # of all models, but never more than MOST_SHARE of the disk's free space
MOST_SHARE = 0.5
WORTH = 50_000  # points from which a model is cached: smaller ones are built in less than half a second
MADE_BY = read, without_strays, select_normals, Model  # what turns files into a model
SETTLED = 2.0  # seconds since a file's last change: a second change within the clock's tick would go unnoticed


@dataclass(frozen=True)
class Entry:
    """A place for one model in the cache folder, whether it is stored there or not.

    Attributes
    ----------
    path : path
        File of the saved model; its description is stored next to it as JSON.
    about : dict
        What the model is made of, as JSON types: path, size and modification time of its files, and how they are read
        and built.
    """

    path: Path
    about: Mapping[str, Any]

    def load(self) -> Model | None:
        """Load the model; return None if it is missing or damaged. Warnings given when it was built are repeated."""
        if not self.path.exists():
            return None
        try:
            model = Model.load(self.path)
            os.utime(self.path)  # marks it as most recently used
        except (OSError, ValueError):
            _remove(self.path)
            return None
        for note in _description(self.path).get("notes", []):
            warn(str(note), stacklevel=2)
        return model

    def store(self, model: Model, notes: Sequence[str] = (), progress: StageProgress | None = None) -> bool:
        """Store a model in the cache; return whether that was done. Disk errors are ignored.

        Not stored are models of under 50,000 points, models larger than the cache, and those whose files have just
        changed.

        notes : warnings given when the model was built, which `load` repeats
        """
        if len(model.points) < WORTH or not self._is_unchanged() or model.nbytes > _limit():
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

    def _is_unchanged(self) -> bool:
        """Return whether the model's files are as described in `about` and were last written over 2 seconds ago."""
        with suppress(OSError):
            local = [facts for facts in self.about["files"] if "address" not in facts]
            files = [Path(facts["path"]) for facts in local]
            return _facts_of(files) == local and all(time.time() - file.stat().st_mtime > SETTLED for file in files)
        return False


def entry_of(files: Sequence[Location], made: Mapping[str, Any]) -> Entry | None:
    """Return the cache entry for the model of some files.

    Its name is a hash of the arguments and of the package's sources. Return None if the server of a remote file does
    not say which version of the file it has: changes would go unnoticed.

    Parameters
    ----------
    files : sequence of Path or RemoteFile
    made : dict
        How the files are read and built, as JSON types.
    """
    if any(isinstance(file, RemoteFile) and not file.facts.tag for file in files):
        return None
    about = {"files": _facts_of(files), "made": dict(made)}
    text = json.dumps([about, source_key()], sort_keys=True)
    return Entry(folder() / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}{SAVED}", about)


def built(build: Callable[[], Model]) -> tuple[Model, list[str]]:
    """Call a function that builds a model; return the model and the warnings that it gave, which are also passed on."""
    with collect_warnings() as notes:
        model = build()
    for note in notes:
        warn(note, stacklevel=2)
    return model, notes


def folder() -> Path:
    """Return the folder of cached models: in the folder that POINTRAY_CACHE names, else in the user's cache folder."""
    base = os.environ.get("POINTRAY_CACHE") or platformdirs.user_cache_dir("pointray", appauthor=False)
    return Path(base) / FOLDER


def describe() -> list[dict[str, Any]]:
    """Describe the cached models, most recently used first.

    Each dict has path, bytes, used (time in seconds) and, if its description is readable, files (path, bytes, written),
    made (how they were read and built), notes (warnings) and points (their number).
    """
    found = []
    for path in _by_age():
        with suppress(OSError):
            facts = path.stat()
            found.append({"path": path, "bytes": facts.st_size, "used": facts.st_mtime, **_description(path)})
    return found[::-1]


def clear() -> tuple[int, int]:
    """Remove all cached models; return their number and their total size in bytes."""
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
    """Return a hash of all sources that decide what a model is: file formats, reading, outliers, normals and `Model`.

    It includes the modules that these import. Models cached by another version of these sources are not found.
    """
    return key_of([*(Path(inspect.getfile(each)) for each in MADE_BY), *format_files()], deferred=True)


def _facts_of(files: Sequence[Location]) -> list[dict[str, Any]]:
    """Return path, size and time of each file; for a remote file its URL without secrets, size, version and `address`.

    The address tells files apart whose URLs differ in secret parts.
    """
    facts = []
    for file in files:
        size, written = stamp(file)
        remote = {"address": file.key} if isinstance(file, RemoteFile) else {}
        facts.append({"path": str(file.resolve()), "bytes": size, "written": written, **remote})
    return facts


def _description(path: Path) -> dict[str, Any]:
    """Return the description of a cached model, from the JSON file next to it; empty if that is missing or damaged."""
    with suppress(OSError, ValueError, RecursionError):  # RecursionError: deeply nested brackets
        found = json.loads(path.with_suffix(".json").read_bytes())
        if isinstance(found, dict) and _is_sound(found):
            return found
    return {}


def _is_sound(description: dict[str, Any]) -> bool:
    """Return whether the entries of a cached model's description exist and have the right types."""
    files, notes = description.get("files"), description.get("notes")
    return (
        isinstance(files, list)
        and all(isinstance(file, dict) and isinstance(file.get("path"), str) for file in files)
        and isinstance(notes, list)
        and type(description.get("points")) is int
    )


def _by_age() -> list[Path]:
    """Return the files of all cached models, least recently used first."""
    ages = []
    for path in folder().glob(f"*{SAVED}"):
        with suppress(OSError):
            if not path.name.startswith("."):
                ages.append((path.stat().st_mtime, path))
    return [path for _, path in sorted(ages)]


def _limit() -> float:
    """Return the largest total size of the cached models in bytes: 16 GiB, but at most half of the disk's free space.

    The space of the models themselves counts as free.
    """
    place = folder()
    while not place.exists():
        place = place.parent
    used = sum(model["bytes"] for model in describe())
    return min(MOST_BYTES, MOST_SHARE * (shutil.disk_usage(place).free + used))


def _prune(keep: Path) -> None:
    """Remove the least recently used models until the others fit into the limit of the cache.

    keep : file of the model just stored, which is never removed
    """
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
    """Remove a cached model and its description; processes that have mapped the file can still read it."""
    for one in (path, path.with_suffix(".json")):
        with suppress(OSError):
            one.unlink()
