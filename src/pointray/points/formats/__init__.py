"""Files -> Points and back: one file a format, whose name is the extension.

Each has `read(path, progress)`, which returns Points, and perhaps `write(file, points)`; both raise ValueError.
Files whose names begin with _ are parts of formats. A new format is a file here and nothing else; a second extension of
it is a file that imports both functions.

ply : binary and text; _ply_header : what a file announces; _ply_lists : rows that hold lists of varying length

Begin with `read` of ply.
"""
