"""PLY, ascii and binary.

ply : the vertices; _header : what a file announces; _lists : rows that hold lists of varying length; _ascii : rows of
text; _names : properties that are normals and colours; _write : writing
"""
