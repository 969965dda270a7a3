"""Outliers: points that belong to no surface, classified by kind; docs/strays.md describes the rules.

find : `find_strays`, `merge_layers`, `without_strays`
floors : local surface of each point, from local_fits (all points) and examine (suspects); fits : robust fits
layers, search : second layers, merged by default; passes, heights : misaligned scans
veils : mixed returns, as seen from the scanner; groups, links : sparse points, and small floating groups

Begin with find, then floors.
"""

from .find import Strays, find_strays, merge_layers, without_strays
from .layers import merge_for_model

__all__ = ["Strays", "find_strays", "merge_for_model", "merge_layers", "without_strays"]
