"""The implicit surface of a point cloud and its intersection with rays (Wald and Seidel 2005).

splats : radii and supports of points, subsampling, levels of detail, scattered points (part II)
tree : the kd-tree over splats (part IV)
intersect : the implicit surface, and rays in one voxel (parts I and III)
trace : rays through the tree and through all instances of a scene (part IV)

Start with splats/support, tree/build, intersect/surface, trace/traverse.
"""
