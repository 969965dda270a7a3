"""Files -> `Points` and back: one file a format.

Each has a `FORMAT` (`_source.Format`), which says how a file is recognised, opened and perhaps written. Files whose
names begin with _ are parts of formats. A new format is a file here and nothing else.

_source : what a reader gives
ply : binary and text; _ply_header : what a file announces; _ply_lists : rows that hold lists of varying length
las : LAS, LAZ and COPC; _las_header : what a file announces; _las_rows : rows as columns; _las_laz : compressed chunks;
    _las_copc : nodes of an octree; _las_crs : coordinate systems; _las_write : writing

Begin with _source, then ply.
"""
