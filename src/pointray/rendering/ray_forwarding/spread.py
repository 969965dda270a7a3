"""The option `spread`: whether models are spread over the workers of a cluster."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.arguments import check_flag
from ...base.executor import backend
from ..settings import Settings

NOTHING: NDArray[np.int64] = np.zeros(0, np.int64)  # rows of instances held by the shading process
WITHOUT = "baked", "cost"  # integrators that need the models in the same process


def check_spread(spread: bool | None, client: Any, settings: Settings) -> bool | None:
    """Return whether each worker of a cluster opens only some parts of models; None: only if memory requires it.

    ValueError if it is required without a client, or the integrator needs all models in one process.

    spread : as given to `render`; None: the client's default
    """
    if spread is None and (client is None or not backend().is_spread_preferred(client)):
        return False if settings.integrator in WITHOUT else None
    spread = True if spread is None else spread
    check_flag(spread, "spread")
    if spread and client is None:
        raise ValueError("spread needs a Dask client, whose workers hold the models")
    if spread and settings.integrator in WITHOUT:
        raise ValueError(f"spread: the integrator {settings.integrator!r} needs all models in one process")
    return spread
