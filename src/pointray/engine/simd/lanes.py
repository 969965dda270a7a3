"""Construction of vectors from numbers, and operations per lane and across lanes."""

from __future__ import annotations

from typing import Any

import llvmlite.ir as ir
from numba.core import cgutils, types

from ..jit.intrinsics import intrinsic
from .vector import F4, F8, F16, FLAGS, I16, INT, Vector, broadcast, shuffle


def _maker(vector: Vector, doc: str) -> Any:
    def make(typingctx: Any, value: Any) -> Any:
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return broadcast(builder, args[0], vector)

        return vector(vector.scalar), codegen

    make.__doc__ = doc
    return intrinsic(make)


broadcast8 = _maker(F8, "Repeat a number in all 8 lanes.")
broadcast16 = _maker(F16, "Repeat a number in all 16 lanes.")


@intrinsic
def quarters(typingctx: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return a vector of 16 with `a` in lanes 0 to 3, `b` in lanes 4 to 7, and so on. a, b, c, d : float32"""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        four = ir.Constant(F4.llvm, ir.Undefined)
        for lane, value in enumerate(args):
            four = builder.insert_element(four, value, INT(lane))
        return shuffle(builder, four, four, [lane // 4 for lane in range(16)])

    return F16(*[types.float32] * 4), codegen


@intrinsic
def fours(typingctx: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return a vector of 16 that repeats the numbers a, b, c, d in each quarter (four lanes). a, b, c, d : float32"""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        four = ir.Constant(F4.llvm, ir.Undefined)
        for lane, value in enumerate(args):
            four = builder.insert_element(four, value, INT(lane))
        return shuffle(builder, four, four, [lane % 4 for lane in range(16)])

    return F16(*[types.float32] * 4), codegen


@intrinsic
def vmin(typingctx: Any, a: Any, b: Any) -> Any:
    """Return the lesser of each pair of lanes; if either is NaN, that of b (one instruction on x86)."""
    return _choose("<", a, b)


@intrinsic
def vmax(typingctx: Any, a: Any, b: Any) -> Any:
    """Return the greater of each pair of lanes; if either is NaN, that of b (one instruction on x86)."""
    return _choose(">", a, b)


def _choose(symbol: str, a: Any, b: Any) -> Any:
    vector = a if isinstance(a, Vector) else b

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered(symbol, *args), *args)

    return vector(vector, vector), codegen


def _llvm_unary(name: str, doc: str) -> Any:
    def make(typingctx: Any, a: Any) -> Any:
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            kind = sig.args[0].llvm if isinstance(sig.args[0], Vector) else ir.FloatType()
            suffix = f"v{sig.args[0].lanes}f32" if isinstance(sig.args[0], Vector) else "f32"
            called = ir.FunctionType(kind, [kind])
            return builder.call(cgutils.get_or_insert_function(builder.module, called, f"llvm.{name}.{suffix}"), args)

        return a(a), codegen

    make.__doc__ = doc
    return intrinsic(make)


vabs = _llvm_unary("fabs", "Return absolute values.")
vsqrt = _llvm_unary("sqrt", "Return square roots of a vector or a float32; NaN for negative numbers.")


@intrinsic
def trunc(typingctx: Any, a: Any) -> Any:
    """Truncate float32 lanes toward zero. Values must be within int32, so that no processor needs a library call."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        vector = sig.args[0]
        return builder.sitofp(builder.fptosi(args[0], ir.VectorType(INT, vector.lanes)), vector.llvm)

    return a(a), codegen


@intrinsic
def bit_fields(typingctx: Any, words: Any, a: Any, b: Any, c: Any, d: Any, mask: Any) -> Any:
    """Extract bits of 16 int32 lanes as float32, with another shift for each quarter (four lanes).

    Lanes 0 to 3 become (word >> a) & mask, lanes 4 to 7 (word >> b) & mask, and so on.
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        four = ir.Constant(ir.VectorType(INT, 4), ir.Undefined)
        for lane, value in enumerate(args[1:5]):
            four = builder.insert_element(four, value, INT(lane))
        shifts = shuffle(builder, four, four, [lane // 4 for lane in range(16)])
        field = builder.and_(builder.lshr(args[0], shifts), broadcast(builder, args[5], I16))
        return builder.sitofp(field, F16.llvm)

    return F16(I16, *[types.int32] * 5), codegen


@intrinsic
def power_of_two(typingctx: Any, exponents: Any) -> Any:
    """Return 2 to the power of each float32 lane, which must be a whole number from -126 to 127."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        biased = builder.add(builder.fptosi(args[0], I16.llvm), broadcast(builder, INT(127), I16))
        return builder.bitcast(builder.shl(biased, broadcast(builder, INT(23), I16)), F16.llvm)

    return F16(F16), codegen


@intrinsic
def one_bit(typingctx: Any, places: Any) -> Any:
    """Return 16 int32 lanes with one bit set in each, at an index given for each lane.

    places : the indices, float32, from 0 to 31 after truncation
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.shl(broadcast(builder, INT(1), I16), builder.fptosi(args[0], I16.llvm))

    return I16(F16), codegen


@intrinsic
def select(typingctx: Any, mask: Any, a: Any, b: Any) -> Any:
    """Return a vector with the lane of a where the mask is set, else the lane of b."""
    vector = a if isinstance(a, Vector) else b

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(*args)

    return vector(mask, vector, vector), codegen


@intrinsic
def bits(typingctx: Any, mask: Any) -> Any:
    """Return a mask of lanes as an integer, lane 0 in the lowest bit."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        word = builder.bitcast(args[0], ir.IntType(sig.args[0].lanes))
        return builder.zext(word, ir.IntType(64))

    return types.int64(mask), codegen


@intrinsic
def mask16(typingctx: Any, word: Any) -> Any:
    """Return the lowest 16 bits of an integer as a mask of 16 lanes, the lowest bit in lane 0."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        word = builder.trunc(args[0], ir.IntType(16))
        return builder.bitcast(word, ir.VectorType(ir.IntType(1), 16))

    return Vector("mask", 16)(types.int64), codegen


@intrinsic
def float_bits(typingctx: Any, value: Any) -> Any:
    """Return the bits of a float32 as an int32, of a float64 as an int64."""
    whole: Any = {types.float32: types.int32, types.float64: types.int64}.get(value)
    if whole is None:
        return None

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.bitcast(args[0], ir.IntType(sig.return_type.bitwidth))

    return whole(value), codegen


@intrinsic
def count_bits(typingctx: Any, word: Any) -> Any:
    """Count the set bits of an integer of 64 bits."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.ctpop(args[0])

    return types.int64(types.int64), codegen


@intrinsic
def count_trailing_zeros(typingctx: Any, word: Any) -> Any:
    """Return the index of the lowest set bit of an integer, which must not be 0."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), codegen


@intrinsic
def lane(typingctx: Any, vector: Any, index: Any) -> Any:
    """Return one lane of a vector as a number. index : of the lane, from 0"""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.extract_element(args[0], args[1])

    return vector.scalar(vector, types.int64), codegen


def _reducer(name: str, doc: str) -> Any:
    def reduce(typingctx: Any, vector: Any) -> Any:
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            kind = ir.FunctionType(ir.FloatType(), [vector.llvm])
            function = cgutils.get_or_insert_function(
                builder.module, kind, f"llvm.vector.reduce.{name}.v{vector.lanes}f32"
            )
            return builder.call(function, args, fastmath=("nnan", "nsz"))

        return types.float32(vector), codegen

    reduce.__doc__ = doc
    return intrinsic(reduce)


reduce_min = _reducer("fmin", "Return the least lane; no lane may be NaN.")
reduce_max = _reducer("fmax", "Return the greatest lane; no lane may be NaN.")


def _folder(steps: tuple[int, ...], doc: str) -> Any:
    def fold(typingctx: Any, vector: Any) -> Any:
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            value = args[0]
            for step in steps:
                swapped = shuffle(builder, value, value, [lane ^ step for lane in range(16)])
                value = builder.fadd(value, swapped, flags=FLAGS)
            return value

        return F16(F16), codegen

    fold.__doc__ = doc
    return intrinsic(fold)


sum_over_quarters = _folder((4, 8), "Add the four quarters lane by lane; repeat the sum in all of them.")
sum_over_lanes = _folder((1, 2, 4, 8), "Add all lanes; repeat the sum in all of them.")


def _picker(quarter: int, doc: str) -> Any:
    def pick(typingctx: Any, vector: Any) -> Any:
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return shuffle(builder, args[0], args[0], [4 * quarter + lane % 4 for lane in range(16)])

        return F16(F16), codegen

    pick.__doc__ = doc
    return intrinsic(pick)


first_quarter = _picker(0, "Repeat the first quarter in all four.")
third_quarter = _picker(2, "Repeat the third quarter in all four.")
last_quarter = _picker(3, "Repeat the last quarter in all four.")


@intrinsic
def shift_lane(typingctx: Any, before: Any, vector: Any) -> Any:
    """Shift a vector of 16 up by one lane; the last lane of `before`, another vector, becomes the first."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return shuffle(builder, args[0], args[1], list(range(15, 31)))

    return F16(F16, F16), codegen


@intrinsic
def shift_quarter(typingctx: Any, before: Any, vector: Any) -> Any:
    """Shift a vector of 16 up by four lanes; the last four lanes of `before` become the first.

    With four rays in the lanes of a quarter, and a sample of each in every quarter, each sample gets its predecessor.
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return shuffle(builder, args[0], args[1], list(range(12, 28)))

    return F16(F16, F16), codegen


@intrinsic
def columns(typingctx: Any, vector: Any) -> Any:
    """Return four vectors of 16: lanes 0, 4, 8, 12 of the vector, repeated in every quarter; then 1, 5, 9, 13, etc."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        parts = [shuffle(builder, args[0], args[0], [lane % 4 * 4 + k for lane in range(16)]) for k in range(4)]
        return context.make_tuple(builder, sig.return_type, parts)

    return types.UniTuple(vector, 4)(vector), codegen


@intrinsic
def sums_of_fours(typingctx: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return a vector of 16: each quarter (four lanes) has four sums, over its own lanes of a, of b, of c and of d."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        def pairs(x: Any, y: Any) -> Any:
            even = [lane // 4 * 4 + lane % 2 * 2 + lane % 4 // 2 * 16 for lane in range(16)]
            odd = [k + 1 for k in even]
            return builder.fadd(shuffle(builder, x, y, even), shuffle(builder, x, y, odd), flags=FLAGS)

        return pairs(pairs(args[0], args[1]), pairs(args[2], args[3]))

    return F16(F16, F16, F16, F16), codegen
