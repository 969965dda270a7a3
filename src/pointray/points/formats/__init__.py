"""Files -> Points and back: one file a format, which `choices.FORMATS` names.

Each has `read(path, progress)`, which returns Points, and perhaps `write(file, points)`; both raise ValueError.

ply : binary and text; ply_header : what a file announces; ply_lists : rows that hold lists of varying length

Begin with `read` of ply.
"""
