"""File -> Points: one file a format; normals where they are missing; models made by formula."""

from .files import read, write
from .given_normals import check_normals
from .normals import estimate_normals
from .procedural import procedural, procedural_distance

__all__ = ["check_normals", "estimate_normals", "procedural", "procedural_distance", "read", "write"]
