"""Meshes, through trimesh.

mesh : OBJ, STL, glTF, OFF; _load : what trimesh makes of them; _points : vertices, or points on triangles
"""
