"""Files -> `Points` and back: one file a format.

Each has a `FORMAT` (`_source.Format`), which says how a file is recognised, opened and perhaps written. Files whose
names begin with _ are parts of formats. A new format is a file here and nothing else.

_source : what a reader gives
ply : binary and text; _ply_header : what a file announces; _ply_lists : rows that hold lists of varying length
text : .xyz, .csv, .pts and the like; ptx : scans in grids
_lines, _first_look, _columns, _text_source : what the columns of a text are, and its rows
_numbers, _number_kernel, _powers_of_ten : numbers in text, exactly and fast

Begin with _source, then ply.
"""
