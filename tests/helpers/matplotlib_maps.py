"""The colour maps of matplotlib that pointray contains: `python tests/helpers/matplotlib_maps.py` rewrites them."""

from __future__ import annotations

import numpy as np

from pointray.base.choices import COLORMAPS
from pointray.shade.colormaps import TABLES


def map_of_matplotlib(name: str) -> np.ndarray:
    """A map's colours, (n, 3) uint8."""
    import matplotlib

    found = matplotlib.colormaps[name]
    return np.rint(255 * found(np.arange(found.N))[:, :3]).astype(np.uint8)


if __name__ == "__main__":
    np.savez_compressed(TABLES, **{name: map_of_matplotlib(name) for name in COLORMAPS})
    print(f"{TABLES}: {TABLES.stat().st_size:,} bytes")
