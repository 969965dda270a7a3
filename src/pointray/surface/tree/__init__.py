"""Acceleration structure: a kd-tree that maps space to the splats and the surface in it (parts III and IV).

build : all steps in one file; takes `Splats`, returns `engine.kernels.tree.Tree`
settings : kind of surface, sampling and limits of a tree
blocks : four splats, neighbours in kd order, in each block
top, subtrees, cells : cuts of space into roots, and of these into voxels with the blocks over them
near : search for splats near a box
leaves, columns : slab and tight box of each voxel; a slab for each of its 4 x 4 columns
wide : boxes in nodes of eight
scattered : a tree over scattered points, under one root with that of the surface
stored, parts : reading splats back from a tree; helpers for models in parts
indices : validation of trees from files
instance_bvh : BVH over the instances of a scene, also used for its lights (`shade/tables.py`)

Start with build, then cells, then leaves.
"""
