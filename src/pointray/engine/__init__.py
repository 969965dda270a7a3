"""How kernels are written in Python and become machine code.

jit : decorators, compilation, the disk cache, compiled libraries, running on all cores
simd : the vector type of kernels
kernels : the records that kernels share, scratch memory, vectors of three, sampling

Begin with jit/decorators, then kernels/tree.
"""
