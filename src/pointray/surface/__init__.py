"""The paper: points -> a surface that rays hit (Wald and Seidel 2005).

splats : radii and supports of the points, fewer points, levels of detail, scattered points (part II)
tree : the kd-tree over splats (part IV)
intersect : the implicit surface, and rays in one voxel (parts I and III)
trace : rays through the tree and through all instances of a scene (part IV)

Begin with splats/support, tree/build, intersect/surface, trace/traverse.
"""
