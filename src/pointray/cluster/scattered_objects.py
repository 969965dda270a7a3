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
    """An object that a client sends to its workers once (Dask's `scatter`), although many jobs need it.

    name : shown on the dashboard; future : keeps the object on the workers; None until it is sent
    """

    name: str
    value: Any
    future: Any = None

    def send(self, client: Any) -> Any:
        """Return the Dask future of the object for use in jobs; send it first if no worker has it."""
        if self.future is None or self.future.status != "finished":
            key = f"{self.name}-{uuid.uuid4().hex}"
            self.future = client.scatter({key: self.value}, timeout=PATIENCE)[key]
        return self.future


@dataclass
class ScatteredObjects:
    """The objects that a client has sent to its workers by Dask's `scatter`.

    by_owner : the sent objects; each stays on the workers as long as its owner, such as a model, lives here
    unseen : files of models that some worker cannot read, or sees in another state; these models are sent
    asked : files of models that all workers were asked about
    """

    client: Any
    by_owner: WeakKeyDictionary[Any, ScatteredObject] = field(default_factory=WeakKeyDictionary)
    unseen: set[Place] = field(default_factory=set)
    asked: set[Place] = field(default_factory=set)

    def of(self, owner: Any, name: str, value: Any) -> ScatteredObject:
        """Return the object to be sent to workers (Dask's `scatter`) for an owner, a new one if its value has changed.

        Sends nothing yet.

        owner : the object stays on the workers as long as this one lives; name : shown on the dashboard
        """
        scattered = self.by_owner.get(owner)
        if scattered is None or not _is_same(scattered.value, value):
            scattered = self.by_owner[owner] = ScatteredObject(name, value)
        return scattered

    def of_model(self, model: Model) -> ScatteredObject | Place:
        """Return what to send for a model: the place (path, size, time) of its file if workers see it, or the model."""
        place = model.place
        if place is not None and place not in self.unseen:
            return place
        # A copy, as levels of detail may be added to the model later.
        return self.of(model, f"model of {len(model.points)} points", copy.copy(model))


def _is_same(old: Any, new: Any) -> bool:
    """Return whether two values are the same object, or copies of a model with the same levels of detail."""
    if isinstance(old, Model) and isinstance(new, Model):
        return old.levels is new.levels
    return old is new


def check_spreadable(model: Model) -> Place:
    """Return the place of the folder of a model in parts, where workers open the parts; ValueError if it is missing.

    A `Place` is a path with the size and time of the file.
    """
    if model.place is None:
        raise ValueError("spread: the folder of a model in parts is missing or has changed: load the model again")
    return model.place


_OBJECTS: WeakKeyDictionary[Any, ScatteredObjects] = WeakKeyDictionary()  # by client


def scattered_objects_of(client: Any) -> ScatteredObjects:
    """Return the objects that a client has sent to its workers (Dask's `scatter`); the same object for each call."""
    if client not in _OBJECTS:
        _OBJECTS[client] = ScatteredObjects(client)
    return _OBJECTS[client]
