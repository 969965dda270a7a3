"""Ahead-of-time compilation of pointray's kernels, for installations without Numba. Not part of the package.

signatures : argument types of each kernel, recorded in signatures.json
targets : CPUs and operating systems
codegen : Numba's compiler, configured for a target; entry, emit : C function and machine code of a kernel
objects : parallel compilation of all kernels; link : object files and runtime.c -> shared library
library : libraries and their manifest

Begin with __main__.
"""
