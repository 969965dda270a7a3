"""A tree and rays -> hits (part IV of the paper): through the nodes of a model, and through all instances of a scene.

traverse, tile : traversal of one model's tree, from its root to its leaves
space, group, instance : rays go from the world into a model's space, similar rays together, and their hits come back
instance_bvh, world, plane : which instances rays may meet; all instances and planes, and the nearest hit
hits, paint : what has been hit: position, normal, colour, attribute
cast : batches of rays from NumPy

Pairs that do the same for one ray and for the rays of a tile:

| one ray | the rays of a tile |
|---|---|
| `traverse.closest` | `tile.closest_of_tile` |
| `traverse.walk_begin` | `tile._walk_begin` |
| `traverse._voxel_interval`, `traverse._slab_interval` | `tile._leaf_intervals` |
| `traverse.prefetch_columns` | `tile._prefetch_search` |

Begin with traverse, then tile, then world.
"""
