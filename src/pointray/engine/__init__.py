"""Kernels: written in Python, compiled to machine code.

jit : decorators, compilation, disk cache, compiled libraries, execution on all cores
simd : the vector type of kernels
kernels : records shared by kernels, scratch memory, vectors of three numbers, sampling

Begin with jit/decorators, then kernels/tree.
"""
