"""A torus seen by two scanners."""

import numpy as np

import pointray as pr
from pointray import Points
from pointray.cloud.georeference import Georeference

WEST, EAST = (-5.0, 0.0, 0.3), (5.0, 0.0, -0.2)

BOTH = Georeference(stations=(WEST, EAST))


def seen_torus(count=6000):
    """A torus about x, each point with the station that it faces more, and the cosine of the angle between them."""
    made = pr.procedural("torus", count)
    torus = Points(np.roll(made.positions, 1, axis=1), np.roll(made.normals, 1, axis=1))
    away = [np.array(station) - torus.positions for station in BOTH.stations]
    faces = np.array([np.einsum("ij,ij->i", torus.normals, a / np.linalg.norm(a, axis=1)[:, None]) for a in away])
    return torus, faces.argmax(axis=0), faces.max(axis=0)
