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
    """Source of the baked light of a scene.

    Attributes
    ----------
    settings : BakeSettings
        Used if there is no file.
    file : Path or None
    key : Key or None
        Key of the file in the scene file; None: given by an option.
    """

    settings: BakeSettings
    file: Path | None = None
    key: Key | None = None

    @property
    def found(self) -> Path | None:
        """The file, if it exists."""
        return self.file if self.file is not None and self.file.exists() else None


def check_bake(source: Source, seed: int) -> BakePlan:
    """Return the plan of the table `bake`. A file is checked, but not read. seed : default, that of images"""
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
    """Return light that was baked for this scene; ValueError if it does not fit."""
    baked = Baked.load(path, scene)
    reason = baked.stale
    if reason is not None:
        raise ValueError(f"{path}: light does not fit the scene: {reason.partition(':')[0]} since it was baked")
    return baked
