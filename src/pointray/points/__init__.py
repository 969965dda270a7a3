"""File -> Points: a module for each format, estimates of missing normals, and models made by formula."""

from .files import read, write
from .normals.estimate import estimate_normals
from .normals.given import check_normals
from .procedural import procedural, procedural_distance

__all__ = ["check_normals", "estimate_normals", "procedural", "procedural_distance", "read", "write"]
