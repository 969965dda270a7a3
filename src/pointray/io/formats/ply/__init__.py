"""PLY, ascii and binary.

ply : the vertices; _header : what a file announces; _lists : rows that hold lists of varying length; _binary, _ascii :
rows without and of text; _faces : triangles; _names : properties that are normals and colours; _write : writing
"""
