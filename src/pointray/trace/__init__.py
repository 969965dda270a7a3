"""A tree and rays -> hits (part IV of the paper): through the nodes of a model, and through all instances of a scene.

traverse, tile : from the root of one model's tree to its leaves
space, group, instance : from the world into a model's space, rays that are alike together, and the hits back
instance_bvh, world, plane : which instances rays may meet, all of them and the planes, the nearest hit
hits, paint : what has been hit: place, normal, colour, attribute
cast : batches of rays from NumPy

Pairs that do the same for one ray and for the rays of a tile:

| one ray | the rays of a tile |
|---|---|
| `traverse.closest` | `tile.closest_of_tile` |
| `traverse.walk_begin` | `tile._walk_begin` |
| `traverse.prefetch_child` | `tile._prefetch_search` |
| `world.is_blocked` | `world.occlude_tile` |

Begin with traverse, then tile, then world.
"""
