"""Meshes, through trimesh.

mesh : OBJ, STL, glTF, OFF; _load : what trimesh makes of them; _gltf, _text : files as trimesh can read them;
_points : vertices, or points sampled on triangles, and which of both show the surface
"""
