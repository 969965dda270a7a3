"""Intersection of a few rays with the surface in one leaf (parts I and III of the paper).

surface, disc : f and its weights; flat splats
columns : the part of each ray in the slabs of the leaf's columns
gather : lists of the splats near a bundle of rays
lattice : the range of samples to evaluate along each ray
march : search among these samples for intervals in which f changes its sign, or might
refine : root finding between two samples
leaf : the complete search of a leaf
scattered : spheres and single discs, in leaves of their own

Functions that exist for one ray and for several rays of a tile:

| one ray | four rays, or all of a tile |
|---|---|
| `columns.narrow_one` | `columns.narrow` |
| `march.search_one` | `march.search` |
| `leaf.search_alone` | `leaf.search_together` |
| `scattered.nearest_of_leaf` | `scattered.search_leaf`, `scattered.finish_scattered` |

Begin with surface, then leaf, then march.
"""
