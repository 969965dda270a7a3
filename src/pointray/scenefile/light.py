"""The baked light of a scene file: settings of a bake, or a file."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from ..baking.baked import Baked
from ..baking.settings import BakeSettings
from ..base.atomic_write import check_regular
from ..scene.scene import Scene
from .lines import Key
from .source import Source
from .words import TEXT, check_table, optional, words_of

KEY = ("bake",)
WORDS = {**words_of(BakeSettings), "file": optional(TEXT)}


class BakePlan(NamedTuple):
    """Where the baked light of a scene comes from: a file, or a bake with these settings.

    Attributes
    ----------
    settings : BakeSettings
        Used if the file does not exist.
    file : Path or None
        Light written by `pointray bake`.
    key : Key or None
        Where the scene file names it, for messages: ("bake", "file"). None: it was given by a command-line option.
    """

    settings: BakeSettings
    file: Path | None = None
    key: Key | None = None

    @property
    def found(self) -> Path | None:
        """The file of baked light if it exists, otherwise None: the light must be baked."""
        return self.file if self.file is not None and self.file.exists() else None


def check_bake(source: Source, seed: int) -> BakePlan:
    """Check the table `bake` of a scene file and return its contents. A file of baked light is checked, but not read.

    seed : default of the bake's seed, the one that images use
    """
    values = check_table(source, KEY, WORDS) if KEY[0] in source.data else {}
    name = values.pop("file", None)
    with source.errors_at(KEY, values):
        settings = BakeSettings(**{"seed": seed, **values})
    if name is None:
        return BakePlan(settings)
    plan = BakePlan(settings, source.path(name), (*KEY, "file"))
    if plan.found is not None:
        with source.errors_at((*KEY, "file")):
            check_regular(plan.found)
    return plan


def load_light(path: Path, scene: Scene) -> Baked:
    """Read a file of baked light; raise ValueError if the scene has changed since it was baked."""
    baked = Baked.load(path, scene)
    reason = baked.stale
    if reason is not None:
        raise ValueError(f"{path}: light does not fit the scene: {reason.partition(':')[0]} since it was baked")
    return baked
