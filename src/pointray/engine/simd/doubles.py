"""Vectors of float64: conversion from and to float32, sums of squares without fused rounding, and counters."""

from __future__ import annotations

from typing import Any

from numba.core import types

from ..jit.intrinsics import intrinsic
from .vector import D8, F8, F16, I8, I16, broadcast, shuffle


def _widener(lanes: list[int], doc: str) -> Any:
    def widen(typingctx: Any, vector: Any) -> Any:
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return builder.fpext(shuffle(builder, args[0], args[0], lanes), D8.llvm)

        return D8(F16), codegen

    widen.__doc__ = doc
    return intrinsic(widen)


widen_low = _widener(list(range(8)), "Convert lanes 0 to 7 of 16 float32 to float64.")
widen_high = _widener(list(range(8, 16)), "Convert lanes 8 to 15 of 16 float32 to float64.")


@intrinsic
def narrow(typingctx: Any, low: Any, high: Any) -> Any:
    """Round two vectors of 8 float64 to one vector of 16 float32, those of `low` first."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        a, b = (builder.fptrunc(value, F8.llvm) for value in args)
        return shuffle(builder, a, b, list(range(16)))

    return F16(D8, D8), codegen


@intrinsic
def square_sum(typingctx: Any, x: Any, y: Any, z: Any) -> Any:
    """Return x * x + y * y + z * z for each lane, rounded at each step as in NumPy.

    There is no FMA, so that equal distances stay equal.
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        a, b, c = (builder.fmul(value, value) for value in args)
        return builder.fadd(builder.fadd(a, b), c)

    return x(x, x, x), codegen


@intrinsic
def count_where(typingctx: Any, counts: Any, mask: Any) -> Any:
    """Add 1 to the int32 lanes of `counts` where the mask is set; return the new counts."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.sub(args[0], builder.sext(args[1], sig.return_type.llvm))

    return counts(counts, mask), codegen


def _zeros(vector: Any, doc: str) -> Any:
    def make(typingctx: Any) -> Any:
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return broadcast(builder, context.get_constant(types.int32, 0), vector)

        return vector(), codegen

    make.__doc__ = doc
    return intrinsic(make)


zeros16 = _zeros(I16, "Return 16 int32 zeros.")
zeros8 = _zeros(I8, "Return 8 int32 zeros.")
