"""What a client sends to its workers once: models, baked light, recipes of scenes. It stays there between calls.

A model that was loaded from a file, or saved to one, goes as the file's path; workers that do not see the same file say
so, and get the model itself from then on. What Dask carries is kept as long as its owner lives here: the model, the
light, the call. Dask copies it from worker to worker as jobs need it. If all workers that had it die, it is sent again.
"""

from __future__ import annotations

import copy
import uuid
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

from ..model.model import Model
from ..model.model_file import Place

PATIENCE = 5  # seconds for any worker to be there


@dataclass
class ScatteredObject:
    """A thing that Dask keeps on workers. future : what holds it there"""

    name: str
    thing: Any
    future: Any = None

    def send(self, client: Any) -> Any:
        """The future of the thing, which is sent if it is not there (any more)."""
        if self.future is None or self.future.status != "finished":
            key = f"{self.name}-{uuid.uuid4().hex}"
            self.future = client.scatter({key: self.thing}, timeout=PATIENCE)[key]
        return self.future


@dataclass
class ScatteredObjects:
    """All that one client has sent.

    unseen : files of models that not all workers see
    asked : files of models that all workers were asked for
    """

    client: Any
    kept: WeakKeyDictionary[Any, ScatteredObject] = field(default_factory=WeakKeyDictionary)
    unseen: set[Place] = field(default_factory=set)
    asked: set[Place] = field(default_factory=set)

    def of(self, owner: Any, name: str, thing: Any) -> ScatteredObject:
        """Return what holds a thing; a new one if its owner has another thing now."""
        scattered = self.kept.get(owner)
        if scattered is None or not _is_same(scattered.thing, thing):
            scattered = self.kept[owner] = ScatteredObject(name, thing)
        return scattered

    def of_model(self, model: Model) -> ScatteredObject | Place:
        """A model: the place of its file, or a scattered object."""
        place = model.place
        if place is not None and place not in self.unseen:
            return place
        # Levels of detail may be made later, so that a copy is sent, which they do not change.
        return self.of(model, f"model of {len(model.points)} points", copy.copy(model))


def _is_same(old: Any, new: Any) -> bool:
    """Whether two things are the same, or copies of one model with the same levels of detail."""
    if isinstance(old, Model) and isinstance(new, Model):
        return old.levels is new.levels
    return old is new


def check_spreadable(model: Model) -> Place:
    """The folder of a model in parts, which workers open; ValueError if it is not there."""
    if model.place is None:
        raise ValueError("spread: the folder of a model in parts is gone, or has changed: load it anew")
    return model.place


_PARCELS: WeakKeyDictionary[Any, ScatteredObjects] = WeakKeyDictionary()  # by client


def scattered_objects_of(client: Any) -> ScatteredObjects:
    """All that a client has sent."""
    if client not in _PARCELS:
        _PARCELS[client] = ScatteredObjects(client)
    return _PARCELS[client]
