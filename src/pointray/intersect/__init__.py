"""One leaf and a few rays -> where these meet the surface first (parts I and III of the paper).

surface, disc : f and the weights behind it; flat splats
columns : which part of each ray lies in the leaf's slabs
gather : the splats near a bundle of rays, listed
march : samples along the rays, and where f changes its sign or might
refine : from two samples to the root between them
leaf : these together

Pairs that do the same for one ray and for rays of a tile:

| one ray | four rays, or all of a tile |
|---|---|
| `columns.narrow_one` | `columns.narrow` |
| `march.search_one` | `march.search` |
| `leaf.search_alone` | `leaf.search_together` |

Begin with surface, then leaf, then march.
"""
