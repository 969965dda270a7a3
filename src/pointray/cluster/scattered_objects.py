"""Objects that a client sends to its workers once: models, baked light, recipes of scenes.

A model with a file is sent as the file's path, or as the model itself once a worker has reported that it does not see
that file. Workers keep an object as long as its owner (the model, the light, the call) lives here. Dask copies it
between workers as needed. It is sent again if all workers that had it are lost.
"""

from __future__ import annotations

import copy
import uuid
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

from ..model.model import Model
from ..model.model_file import Place

PATIENCE = 5  # timeout in seconds for any worker to be available


@dataclass
class ScatteredObject:
    """An object on Dask's workers. future : keeps it there"""

    name: str
    value: Any
    future: Any = None

    def send(self, client: Any) -> Any:
        """Return the future of the object, which is sent if no worker has it."""
        if self.future is None or self.future.status != "finished":
            key = f"{self.name}-{uuid.uuid4().hex}"
            self.future = client.scatter({key: self.value}, timeout=PATIENCE)[key]
        return self.future


@dataclass
class ScatteredObjects:
    """The objects that a client has sent, by owner.

    unseen : files of models that some worker does not see
    asked : files of models that all workers were asked about
    """

    client: Any
    by_owner: WeakKeyDictionary[Any, ScatteredObject] = field(default_factory=WeakKeyDictionary)
    unseen: set[Place] = field(default_factory=set)
    asked: set[Place] = field(default_factory=set)

    def of(self, owner: Any, name: str, value: Any) -> ScatteredObject:
        """Return the scattered object of an owner, a new one if the object has changed."""
        scattered = self.by_owner.get(owner)
        if scattered is None or not _is_same(scattered.value, value):
            scattered = self.by_owner[owner] = ScatteredObject(name, value)
        return scattered

    def of_model(self, model: Model) -> ScatteredObject | Place:
        """Return the place of a model's file if all workers see it, else a scattered object."""
        place = model.place
        if place is not None and place not in self.unseen:
            return place
        # A copy, as levels of detail may be added to the model later.
        return self.of(model, f"model of {len(model.points)} points", copy.copy(model))


def _is_same(old: Any, new: Any) -> bool:
    """Return whether two objects are the same, or copies of a model with the same levels of detail."""
    if isinstance(old, Model) and isinstance(new, Model):
        return old.levels is new.levels
    return old is new


def check_spreadable(model: Model) -> Place:
    """Return the folder of a model in parts, which workers open; ValueError if it is missing."""
    if model.place is None:
        raise ValueError("spread: the folder of a model in parts is missing or has changed: load the model again")
    return model.place


_OBJECTS: WeakKeyDictionary[Any, ScatteredObjects] = WeakKeyDictionary()  # by client


def scattered_objects_of(client: Any) -> ScatteredObjects:
    """Return the objects that a client has sent."""
    if client not in _OBJECTS:
        _OBJECTS[client] = ScatteredObjects(client)
    return _OBJECTS[client]
