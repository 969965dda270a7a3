"""Support of splats (radius, open border, opposite sheets) from points; subsampling; levels of detail.

support : radii, borders and sheets from one neighbour search (`find_support`)
build : splats of a model in kd order, the input of `build_tree`
radii, voronoi, cells, closed : the smallest radii that cover the surface, from Voronoi cells
wide_discs, gaps : limits of discs that would be too wide
medians : medians over the neighbours of each point
borders, fringe, sheets : open borders; frayed borders of noisy scans; sheets close together
levels, groups, averages : levels of detail
scattered : points that lie on no surface; local_planes : the plane fits that find them
subsample : fewer points; its steps: grow (candidates), cover (selection), subset (fit), deviation (error)
priority_queue : binary heap that grow and cover use

Start with support, then radii. Trees are built from `Splats` of `tree/build.py`, not from those of grow.
"""

from .radii import check_radii, choose_radii

__all__ = ["check_radii", "choose_radii"]
