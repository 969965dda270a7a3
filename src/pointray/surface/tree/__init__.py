"""Splats -> Tree: which splats matter in which part of space, and where the surface can be (parts III and IV).

build : all steps on one page; `Splats` comes in, `engine.kernels.tree.Tree` goes out
blocks : neighbours together, four splats to a block
top, subtrees, cells : space is cut into roots, and these into voxels, each with the blocks that matter in it
near : which splats are near a box
leaves, columns : slab and tight box of each voxel; a slab for each of its 4 x 4 columns
wide : the boxes in nodes of eight
scattered : a tree over scattered points, under one root with that of the surface
stored, parts : splats read back; what models in parts need
indices, check : whether a tree from a file may be used; every rule of a tree, for tests
instance_bvh : another tree, over a scene's instances; also over its lights (`shade/tables.py`)

Begin with build, then cells, then leaves.
"""
