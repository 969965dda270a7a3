"""What kernels of all rooms share: arrays and numbers in, the same out. Nothing here computes with points or light.

tree : what every array of a model means, and what "none" is in each
records : what every array of a scene means: instances, lights, materials, cameras
scratch : one thread's working memory, and the rows of a tile of rays
vec : triples of numbers
sampling : where samples lie, and how they are spread

Begin with tree, then records: the rest of the package is written in their words.
"""
