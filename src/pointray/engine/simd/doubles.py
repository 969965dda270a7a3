"""Vectors of float64: conversion from and to float32, sums of squares without fused rounding, and counters."""

from __future__ import annotations

from typing import Any

from numba.core import types

from ..jit.intrinsics import Code, operation
from .vector import D8, F8, F16, I8, I16, broadcast, shuffle


@operation(D8(F16))
def widen_low(code: Code, vector: Any) -> Any:
    """Convert lanes 0 to 7 of 16 float32 to float64. code : where LLVM instructions are emitted"""
    return code.builder.fpext(shuffle(code, vector, vector, range(8)), D8.llvm)


@operation(D8(F16))
def widen_high(code: Code, vector: Any) -> Any:
    """Convert lanes 8 to 15 of 16 float32 to float64."""
    return code.builder.fpext(shuffle(code, vector, vector, range(8, 16)), D8.llvm)


@operation(F16(D8, D8))
def narrow(code: Code, low: Any, high: Any) -> Any:
    """Round two vectors of 8 float64 to one vector of 16 float32, those of `low` first."""
    a, b = (code.builder.fptrunc(value, F8.llvm) for value in (low, high))
    return shuffle(code, a, b, range(16))


@operation(lambda x, y, z: x(x, x, x))
def square_sum(code: Code, x: Any, y: Any, z: Any) -> Any:
    """Return x * x + y * y + z * z for each lane, rounded at each step as in NumPy.

    There is no FMA, so that equal distances stay equal.
    """
    a, b, c = (code.builder.fmul(value, value) for value in (x, y, z))
    return code.builder.fadd(code.builder.fadd(a, b), c)


@operation(lambda counts, mask: counts(counts, mask))
def count_where(code: Code, counts: Any, mask: Any) -> Any:
    """Add 1 to the int32 lanes of `counts` where the mask is set; return the new counts."""
    return code.builder.sub(counts, code.builder.sext(mask, code.types.return_type.llvm))


@operation(I16())
def zeros16(code: Code) -> Any:
    """Return 16 int32 zeros."""
    return broadcast(code, code.context.get_constant(types.int32, 0), I16)


@operation(I8())
def zeros8(code: Code) -> Any:
    """Return 8 int32 zeros."""
    return broadcast(code, code.context.get_constant(types.int32, 0), I8)
