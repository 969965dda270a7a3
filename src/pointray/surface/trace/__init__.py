"""Intersection of rays with a tree (part IV of the paper), and with all instances and planes of a scene.

traverse, tile : traversal of one model's tree, from its root to its leaves
space, group, instance : transform of rays into a model's space, groups of similar rays, transform of their hits back
instance_bvh, world, plane : the instances that rays may hit; all instances and planes, and the nearest hit
hits, paint : position, normal, colour and attribute of a hit
cast : batches of rays from NumPy

Functions that exist for one ray and for the rays of a tile:

| one ray | the rays of a tile |
|---|---|
| `traverse.closest` | `tile.closest_of_tile` |
| `traverse.walk_begin` | `tile._walk_begin` |
| `traverse._voxel_interval`, `traverse._slab_interval` | `tile._leaf_intervals` |
| `traverse.prefetch_columns` | `tile._prefetch_search` |

Begin with traverse, then tile, then world.
"""
