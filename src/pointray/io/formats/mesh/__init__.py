"""Meshes, read with trimesh.

mesh : OBJ, STL, glTF, OFF; _load : conversion from trimesh; _gltf, _text : files prepared for trimesh;
_points : vertices, or points sampled on triangles, and the choice between them
"""
