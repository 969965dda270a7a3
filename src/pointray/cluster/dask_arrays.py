"""Arrays of Dask whose chunks are made of a scene and of the chunks of other arrays, when they are computed.

Any scheduler of Dask computes them: threads of this process, which take the scene as it is, or workers, which get its
recipe. Nothing of Dask is imported here before somebody brings an array of it.
"""

from __future__ import annotations

import sys
import uuid
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from ..base.arguments import check_real, real_numbers
from ..base.executor import is_chunked
from ..base.extras import require
from .recipe import Stage
from .serialized_scene import SerializedScene
from .worker import worker_here


class Form(NamedTuple):
    """What an array holds for each ray. dtype; columns : the axes that follow those of the rays"""

    dtype: np.dtype[Any]
    columns: tuple[int, ...]


def check_chunks(values: Mapping[str, Any]) -> list[Any]:
    """Arrays of real numbers, by the names of parameters: those of Dask, of which nothing is computed, and others.

    Raises
    ------
    ValueError
        If a dtype is no number, or chunks are of unknown size.
    """
    arrays = []
    for name, value in values.items():
        if not is_chunked(value):
            arrays.append(real_numbers(value, name))
            continue
        check_real(value.dtype, name)
        if np.isnan(value.shape).any():
            raise ValueError(f"{name} has chunks of unknown size: call its compute_chunk_sizes() before")
        arrays.append(value)
    return arrays


class Shared(NamedTuple):
    """Work of several workers on each chunk.

    homes : by the address of a worker, an argument of the work, the last one; another one does it where that is gone
    join : the function of a module, which makes one of what they return: a dict of arrays in the same forms
    """

    homes: Mapping[str, Any]
    join: Callable[[list[dict[str, Any]]], dict[str, Any]]


def chunked_like(
    scene: Stage,
    work: tuple[Any, ...],
    arrays: Sequence[Any],
    forms: Mapping[str, Form],
    shared: Shared | None = None,
) -> dict[str, Any]:
    """Arrays of Dask that are made of rays.

    Parameters
    ----------
    work : function and arguments
        The function of a module takes a snapshot of the scene, these arguments, the chunks of `arrays`, a number of
        threads and a `Progress` (both may be None), and returns a dict of arrays in these forms.
    arrays : sequence
        Origins and directions, (..., 3), and limits, (...), which broadcast.
    shared : Shared, optional
        Those who do the work together. None: whoever is free does it.
    """
    dask, da = (require(name, "cluster", "an array of Dask") for name in ("dask", "dask.array"))
    axes = max(array.ndim - (k < 2) for k, array in enumerate(arrays))
    rays = tuple(range(axes))
    pairs: list[Any] = []
    for k, array in enumerate(arrays):
        own = array.ndim - (k < 2)
        # Axes that arrays have in common are the last ones of the rays; along x, y, z chunks are put together.
        pairs.append(array if is_chunked(array) else da.from_array(array, chunks=-1))
        pairs.append(rays[axes - own :] + ((axes,) if k < 2 else ()))
    serialized = SerializedScene(scene)
    box = dask.delayed(serialized, name=serialized.key, traverse=False)
    make = partial(_make, work=work) if shared is None else partial(_make_shared, work=work, shared=shared)
    options = {"concatenate": True, "dtype": object, "meta": np.empty((0,) * axes, object)}
    packed = da.blockwise(make, rays, *pairs, scene=box, token="pointray-rays", **options)
    made = {}
    for name, (dtype, columns) in forms.items():
        more = tuple(range(axes, axes + len(columns)))
        made[name] = da.blockwise(
            itemgetter(name),
            rays + more,
            packed,
            rays,
            new_axes=dict(zip(more, columns, strict=True)),
            dtype=dtype,
            meta=np.empty((0,) * (axes + len(columns)), dtype),
            token=f"pointray-{name.replace(' ', '-')}",
        )
    return made


def _make(*chunks: Any, work: tuple[Any, ...], scene: SerializedScene) -> Any:
    """The task of a chunk."""
    function, *args = work
    return scene.use(function, (*args, chunks))


def _make_shared(*chunks: Any, work: tuple[Any, ...], shared: Shared, scene: SerializedScene) -> Any:
    """The task of a chunk of which each worker makes its share.

    It sends tasks to them: where the graph says which worker does what, Dask loses that when it optimizes arrays.
    """
    function, *args = work
    if worker_here() is None:
        return shared.join([scene.use(function, (*args, held, chunks)) for held in shared.homes.values()])
    distributed: Any = sys.modules["distributed"]
    with distributed.worker_client() as client:
        sent = client.scatter(list(chunks), hash=False)
        found = []
        for home, held in shared.homes.items():
            told: dict[str, Any] = {"workers": [home], "allow_other_workers": True, "pure": False}
            key = f"pointray-held-{uuid.uuid4().hex}"
            found.append(client.submit(_use, scene, function, (*args, held), *sent, key=key, **told))
        return shared.join(client.gather(found))


def _use(scene: SerializedScene, function: Callable[..., Any], args: tuple[Any, ...], *chunks: Any) -> Any:
    """The task of one worker."""
    return scene.use(function, (*args, chunks))
