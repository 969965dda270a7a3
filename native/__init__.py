"""Compilation of pointray's kernels to native libraries, for installations without Numba. Not part of the package.

signatures : the argument types of each kernel, recorded in signatures.json
targets : processors and systems
codegen : Numba's compiler, set up for a target; entry, emit : a kernel's C function, and its machine code
objects : all kernels, compiled on all cores; link : objects and runtime.c -> one library; library : with its manifest

Begin with __main__.
"""
