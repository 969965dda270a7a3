"""Points -> the support of each: radius, open border, close sheets. Also fewer points for the same surface.

support : all of it, from one search for neighbours (`find_support`, which a model calls)
radii, voronoi, strays : the smallest radii that cover the surface; its cells; discs that would be too wide
medians : what is usual around each point
borders, sheets : where the surface ends; where two of it are close together
levels : levels of detail
scatter : which points are on no surface; its steps: local_planes, scatter_rules
scattered, scattered_levels : radii of points that are drawn as spheres; their levels of detail
subsample : fewer points; its steps: grow (candidates), cover (the choice), subset (the fit), deviation (the error)
heap : what grow and cover sort with

Begin with support, then radii. The `Splats` that a tree is built of is that of `tree/build.py`, not that of grow.
"""

from .radii import check_radii, choose_radii

__all__ = ["check_radii", "choose_radii"]
