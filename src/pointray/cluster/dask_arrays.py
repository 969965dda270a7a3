"""Dask arrays whose chunks are computed from a scene and the chunks of other arrays.

Any Dask scheduler computes them: threads of this process, which use the scene itself, or workers, which get its recipe.
Dask is imported only when a Dask array is passed.
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
from .recipe import SceneLike
from .serialized_scene import SerializedScene
from .worker import worker_here


class ArrayForm(NamedTuple):
    """Type of an array with one value for each ray. columns : shape of a value, such as () or (3,)"""

    dtype: np.dtype[Any]
    columns: tuple[int, ...]


def check_chunks(values: Mapping[str, Any]) -> list[Any]:
    """Return arrays or Dask arrays as arrays of real numbers. Dask arrays are not computed.

    values : arrays by the names of parameters, for messages

    Raises
    ------
    ValueError
        If a dtype is not numeric, or chunks are of unknown size.
    """
    arrays = []
    for name, value in values.items():
        if not is_chunked(value):
            arrays.append(real_numbers(value, name))
            continue
        check_real(value.dtype, name)
        if np.isnan(value.shape).any():
            raise ValueError(f"{name} has chunks of unknown size: call its compute_chunk_sizes() first")
        arrays.append(value)
    return arrays


class Distribution(NamedTuple):
    """Distribution of the work on each chunk of rays over workers that hold different parts of a scene.

    homes : from the address of each worker to the argument of the work that says which parts it holds
    join : module-level function that merges the results (dicts of arrays) of all workers
    """

    homes: Mapping[str, Any]
    join: Callable[[list[dict[str, Any]]], dict[str, Any]]


def chunked_like(
    scene: SceneLike,
    work: tuple[Any, ...],
    arrays: Sequence[Any],
    forms: Mapping[str, ArrayForm],
    shared: Distribution | None = None,
) -> dict[str, Any]:
    """Return a dict of Dask arrays, whose chunks are computed on demand from a scene and the chunks of arrays of rays.

    Parameters
    ----------
    work : (function, *arguments)
        The module-level function is called with a snapshot of the scene, the arguments, the worker's entry in
        `shared.homes` (if given), the tuple of the chunks of `arrays`, a number of threads and a `Progress` (both may
        be None). It returns a dict of arrays as described by `forms`.
    arrays : sequence
        Origins and directions, (..., 3), t_min and t_max, (...), which are broadcast.
    forms : dict of str to ArrayForm
        Type of each returned array, by name.
    shared : Distribution, optional
        Distribution over workers that hold different parts. None: one worker, any, computes a chunk.
    """
    dask, da = (require(name, "cluster", "an array of Dask") for name in ("dask", "dask.array"))
    axes = max(array.ndim - (k < 2) for k, array in enumerate(arrays))
    rays = tuple(range(axes))
    pairs: list[Any] = []
    for k, array in enumerate(arrays):
        own = array.ndim - (k < 2)
        # Arrays with fewer axes broadcast along the first axes of the rays. Chunks are concatenated along x, y, z.
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
    """Compute a chunk of the results: a dict of arrays by name.

    chunks : chunks of origins, directions, t_min and t_max
    work : (function, *arguments); called with a snapshot of the scene, the arguments, `chunks`, a number of threads and
        a progress callback
    """
    function, *args = work
    return scene.use(function, (*args, chunks))


def _make_shared(*chunks: Any, work: tuple[Any, ...], shared: Distribution, scene: SerializedScene) -> Any:
    """Compute a chunk of the results on several workers that hold different parts of a scene: a dict of arrays.

    The tasks are submitted here, as Dask's optimization of arrays drops the assignment to workers from a graph.

    chunks : chunks of origins, directions, t_min and t_max
    work : (function, *arguments); called with a snapshot of the scene, the arguments, the parts that a worker holds,
        `chunks`, a number of threads and a progress callback
    shared : which parts each worker holds, and the function that merges the workers' results
    """
    function, *args = work
    if worker_here() is None:
        return shared.join([scene.use(function, (*args, held, chunks)) for held in shared.homes.values()])
    distributed: Any = sys.modules["distributed"]
    with distributed.worker_client() as client:
        sent = client.scatter(list(chunks), hash=False)
        found = []
        for home, held in shared.homes.items():
            placement: dict[str, Any] = {"workers": [home], "allow_other_workers": True, "pure": False}
            key = f"pointray-held-{uuid.uuid4().hex}"
            found.append(client.submit(_use, scene, function, (*args, held), *sent, key=key, **placement))
        return shared.join(client.gather(found))


def _use(scene: SerializedScene, function: Callable[..., Any], args: tuple[Any, ...], *chunks: Any) -> Any:
    """Compute the results of a chunk of rays for the parts of the scene that one worker holds, on that worker.

    function : called with a snapshot of the scene, `args`, `chunks`, a number of threads and a progress callback
    chunks : chunks of origins, directions, t_min and t_max
    """
    return scene.use(function, (*args, chunks))
