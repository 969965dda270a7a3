"""What kernels of all rooms share: arrays and numbers in, the same out. Nothing here computes with points or light.

records : what every array means that kernels are handed, and what "none" is in each
scratch : one thread's working memory, and the rows of a tile of rays
vec : triples of numbers
sampling : where samples lie, and how they are spread

Begin with records: the rest of the package is written in its words.
"""
