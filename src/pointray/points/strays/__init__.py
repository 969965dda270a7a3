"""Points -> which of them belong to no surface, and of what kind they are; docs/strays.md has the rules.

find : `find_strays`, `merge_layers`, `without_strays`
floors : the surface near each point; fits : what floors are fitted with
veils : mixed returns, as seen from the scanner; groups : sparse points, and small groups that float

Begin with find, then floors.
"""

from .find import Strays, find_strays, merge_layers, without_strays

__all__ = ["Strays", "find_strays", "merge_layers", "without_strays"]
