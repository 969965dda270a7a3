"""Meshes, read with trimesh, and points in GLB files.

mesh : OBJ, STL, glTF, OFF; _load : conversion from trimesh; _gltf, _text : files prepared for trimesh;
_points : vertices, or points sampled on triangles, and the choice between them
glb : points in GLB files; _glb_write : the writer
"""
