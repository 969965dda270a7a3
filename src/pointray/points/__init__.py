"""A file -> `Points`, with normals, cleaned; or models made by formula.

files : `read` and `write`; reading : what `read` is asked for, checked; unpacking : .gz and .zst
formats : a file for each format; known_formats : which there are, and which one a file has
opening, selection : the files, and which of their rows become points
gather : how the rows of several files become one cloud in memory
joining, locating, colors, lacking : what these have in common; positions about an origin; 8 bits; what a file lacks
replacing : how a file is replaced
normals : estimated ones, and whether given ones are the surface's
cleaning, rounding : duplicates and outliers; coordinates that were rounded
strays : points that belong to no surface
trust : which normals of a file are used, and which warnings are given
nearby : the neighbours of a few points among many
procedural : models made by formula

Begin with files, then normals/estimate.
"""

from ..cloud.normals.comparison import check_normals
from ..cloud.normals.estimate import estimate_normals
from .files import read, write
from .procedural import procedural, procedural_distance

__all__ = ["check_normals", "estimate_normals", "procedural", "procedural_distance", "read", "write"]
