"""Records and functions that kernels of all rooms share. Nothing here computes with points or light.

tree : layout of a model's arrays, and the values that mean "none"
records : layout of a scene's arrays: instances, lights, materials, cameras
scratch : one thread's working memory, and the rows of a tile of rays
vec : vectors of three numbers
sampling : stratified random numbers

Files that use many constants of a module import it under its alias, the same everywhere: `tr` for tree, `rec` for
records, `sc` for scratch (`tr.SLAB_LO`, `rec.LIGHT_KIND`, `sc.T_MIN`). Classes and functions are imported by name.

Begin with tree, then records: the rest of the package uses their terms.
"""
