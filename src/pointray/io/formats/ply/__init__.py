"""PLY, ascii and binary.

ply : the reader; _header : elements and counts; _binary, _ascii : vertices; _lists : binary rows with lists;
_faces : triangles; _names : properties of positions, normals and colours; _write : the writer
"""
