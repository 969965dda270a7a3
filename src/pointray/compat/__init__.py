"""Classes of other libraries, for points: change one import.

raycasting_scene : `RaycastingScene`, after Open3D's class of that name
geometries : its points and meshes; occupancy : what is inside of closed surfaces; mesh_samples : points on triangles
pinhole : rays of a pinhole camera; tensors : arrays of callers, such as tensors

Begin with raycasting_scene.
"""

from .raycasting_scene import RaycastingScene

__all__ = ["RaycastingScene"]
