# python examples/scans/ocean.py ocean.ply
#
# The solid surface of the Earth, heights exaggerated 15 times: ETOPO1 at 0.1 degrees from the Python package
# pybacktrack (`pip install --no-deps pybacktrack`, `pip install h5py matplotlib`).
import sys
from importlib.util import find_spec
from pathlib import Path

import h5py
import numpy as np
from matplotlib import colormaps
from scipy.ndimage import map_coordinates

import pointray as pr

POINTS = 1_000_000
RADIUS, EXAGGERATION = 6371.0, 15.0  # km, and a factor

package = Path(find_spec("pybacktrack").origin).parent
with h5py.File(package / "bundle_data" / "topography" / "ETOPO1_0.1.grd") as file:
    grid = file["z"][:] / 1000  # km; rows from -90 degrees of latitude, columns from 0 of longitude

# Even points on a sphere, along a spiral; those of the grid are too dense near the poles.
k = np.arange(POINTS) + 0.5
z = 1 - 2 * k / POINTS
longitude = (k * 180 * (3 - np.sqrt(5))) % 360
latitude = np.degrees(np.arcsin(z))
elevation = map_coordinates(grid, [(latitude + 90) * 10, longitude * 10], order=1, mode="nearest")
across = np.sqrt(1 - z * z)
directions = np.stack([across * np.cos(np.radians(longitude)), across * np.sin(np.radians(longitude)), z], axis=1)
positions = directions * (RADIUS + EXAGGERATION * elevation)[:, None]
colors = colormaps["gist_earth"](0.5 + elevation / 14)[:, :3]
colors = 0.5 * colors + 0.5 * colors.mean(axis=1, keepdims=True)  # less saturated
pr.write(sys.argv[1], pr.Points(positions, colors=colors))
