"""Points -> which of them belong to no surface, and of what kind they are; docs/strays.md has the rules.

find : `find_strays`, `merge_layers`, `without_strays`
floors : the surface near each point, from survey (all points) and examine (those that may be off it); fits : how
layers : second layers, which models merge unasked; passes, heights : scans that do not fit
veils : mixed returns, as seen from the scanner; groups : sparse points, and small groups that float

Begin with find, then floors.
"""

from .find import Strays, find_strays, merge_layers, without_strays
from .layers import merge_for_model

__all__ = ["Strays", "find_strays", "merge_for_model", "merge_layers", "without_strays"]
