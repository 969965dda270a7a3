"""One leaf and a few rays -> where each ray first meets the surface (parts I and III of the paper).

surface, disc : f and its weights; flat splats
columns : which part of each ray lies in the leaf's slabs
gather : a list of the splats near a bundle of rays
lattice : which samples along the rays are evaluated
march : the search along them, where f changes its sign or might
refine : from two samples to the root between them
leaf : puts these together
scattered : spheres and single discs, in leaves of their own

Pairs that do the same for one ray and for several rays of a tile:

| one ray | four rays, or all of a tile |
|---|---|
| `columns.narrow_one` | `columns.narrow` |
| `march.search_one` | `march.search` |
| `leaf.search_alone` | `leaf.search_together` |
| `scattered.nearest_of_leaf` | `scattered.search_leaf`, `scattered.finish_scattered` |

Begin with surface, then leaf, then march.
"""
