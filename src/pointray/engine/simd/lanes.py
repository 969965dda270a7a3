"""Construction of vectors from numbers, and operations per lane and across lanes."""

from __future__ import annotations

from typing import Any

import llvmlite.ir as ir
from numba.core import cgutils, types

from ..jit.intrinsics import Code, operation
from .vector import F4, F8, F16, FLAGS, I16, INT, Vector, broadcast, shuffle


@operation(F8(types.float32))
def broadcast8(code: Code, value: Any) -> Any:
    """Repeat a number in all 8 lanes. code : where LLVM instructions are emitted"""
    return broadcast(code, value, F8)


@operation(F16(types.float32))
def broadcast16(code: Code, value: Any) -> Any:
    """Repeat a number in all 16 lanes."""
    return broadcast(code, value, F16)


@operation(lambda number, like: like(types.float32, like))
def number_like(code: Code, number: Any, like: Any) -> Any:
    """Repeat a number in as many lanes as another vector has. code : where LLVM instructions are emitted"""
    return broadcast(code, number, code.types.return_type)


def _half(vector: Any) -> Any:
    """Return the Numba signature of a function that takes half of a vector's lanes."""
    return Vector(vector.kind, vector.lanes // 2)(vector)


@operation(_half)
def low_half(code: Code, vector: Any) -> Any:
    """Return the first half of a vector's lanes."""
    return shuffle(code, vector, vector, range(code.types.return_type.lanes))


@operation(_half)
def high_half(code: Code, vector: Any) -> Any:
    """Return the second half of a vector's lanes."""
    lanes = code.types.return_type.lanes
    return shuffle(code, vector, vector, range(lanes, 2 * lanes))


@operation(lambda low, high: Vector(low.kind, 2 * low.lanes)(low, high))
def join_halves(code: Code, low: Any, high: Any) -> Any:
    """Return a vector with the lanes of `low`, then those of `high`, which has as many."""
    return shuffle(code, low, high, range(code.types.return_type.lanes))


@operation(F8(F8))
def swap_halves(code: Code, vector: Any) -> Any:
    """Return the last four of 8 lanes, then the first four."""
    return shuffle(code, vector, vector, [*range(4, 8), *range(4)])


@operation(F8(F16))
def middle_half(code: Code, vector: Any) -> Any:
    """Return the second and the third quarter of a vector of 16."""
    return shuffle(code, vector, vector, range(4, 12))


@operation(F8(F16))
def outer_half(code: Code, vector: Any) -> Any:
    """Return the first and the last quarter of a vector of 16."""
    return shuffle(code, vector, vector, [*range(4), *range(12, 16)])


@operation(F16(F8, F8))
def put_around(code: Code, outer: Any, middle: Any) -> Any:
    """Return a vector of 16 with the first four lanes of `outer`, all of `middle`, and the last four of `outer`."""
    return shuffle(code, outer, middle, [*range(4), *range(8, 16), *range(4, 8)])


@operation(F16(F8))
def extend_quarter(code: Code, half: Any) -> Any:
    """Return a vector of 16 with the given 8 lanes, followed by the last four of them twice."""
    return shuffle(code, half, half, [lane if lane < 8 else 4 + lane % 4 for lane in range(16)])


@operation(F16(F8))
def extend_lane(code: Code, half: Any) -> Any:
    """Return a vector of 16 with the given 8 lanes, followed by the last of them eight times."""
    return shuffle(code, half, half, [min(lane, 7) for lane in range(16)])


def _four(code: Code, values: tuple[Any, ...], element: Any) -> Any:
    """Emit code for a vector of four LLVM values, and return its LLVM value.

    code : where LLVM instructions are emitted; element : LLVM type of a lane
    """
    four = ir.Constant(ir.VectorType(element, 4), ir.Undefined)
    for lane, value in enumerate(values):
        four = code.builder.insert_element(four, value, INT(lane))
    return four


@operation(F16(*[types.float32] * 4))
def quarters(code: Code, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return a vector of 16 with `a` in lanes 0 to 3, `b` in lanes 4 to 7, and so on. a, b, c, d : float32"""
    four = _four(code, (a, b, c, d), F4.element)
    return shuffle(code, four, four, [lane // 4 for lane in range(16)])


@operation(F16(*[types.float32] * 4))
def fours(code: Code, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return a vector of 16 that repeats the numbers a, b, c, d in each quarter (four lanes). a, b, c, d : float32"""
    four = _four(code, (a, b, c, d), F4.element)
    return shuffle(code, four, four, [lane % 4 for lane in range(16)])


def _pair(a: Any, b: Any) -> Any:
    """Return the Numba signature of a function of two vectors, or of a vector and a number, which is repeated."""
    vector = a if isinstance(a, Vector) else b
    return vector(vector, vector)


@operation(_pair)
def vmin(code: Code, a: Any, b: Any) -> Any:
    """Return the lesser of each pair of lanes; if either is NaN, that of b (one instruction on x86)."""
    return code.builder.select(code.builder.fcmp_ordered("<", a, b), a, b)


@operation(_pair)
def vmax(code: Code, a: Any, b: Any) -> Any:
    """Return the greater of each pair of lanes; if either is NaN, that of b (one instruction on x86)."""
    return code.builder.select(code.builder.fcmp_ordered(">", a, b), a, b)


def _llvm_unary(code: Code, name: str, a: Any) -> Any:
    """Emit a call of an LLVM function of a float32, or of each lane of a vector.

    code : where LLVM instructions are emitted; name : fabs or sqrt
    """
    kind = code.types.args[0]
    llvm, suffix = (kind.llvm, f"v{kind.lanes}f32") if isinstance(kind, Vector) else (ir.FloatType(), "f32")
    called = ir.FunctionType(llvm, [llvm])
    function = cgutils.get_or_insert_function(code.builder.module, called, f"llvm.{name}.{suffix}")
    return code.builder.call(function, [a])


@operation(lambda a: a(a))
def vabs(code: Code, a: Any) -> Any:
    """Return absolute values."""
    return _llvm_unary(code, "fabs", a)


@operation(lambda a: a(a))
def vsqrt(code: Code, a: Any) -> Any:
    """Return square roots of a vector or a float32; NaN for negative numbers."""
    return _llvm_unary(code, "sqrt", a)


@operation(lambda a: a(a))
def trunc(code: Code, a: Any) -> Any:
    """Truncate float32 lanes toward zero. Values must be within int32, so that no processor needs a library call."""
    vector = code.types.return_type
    return code.builder.sitofp(code.builder.fptosi(a, ir.VectorType(INT, vector.lanes)), vector.llvm)


@operation(F16(I16, *[types.int32] * 5))
def bit_fields(code: Code, words: Any, a: Any, b: Any, c: Any, d: Any, mask: Any) -> Any:
    """Extract bits of 16 int32 lanes as float32, with another shift for each quarter (four lanes).

    Lanes 0 to 3 become (word >> a) & mask, lanes 4 to 7 (word >> b) & mask, and so on.
    """
    four = _four(code, (a, b, c, d), INT)
    shifts = shuffle(code, four, four, [lane // 4 for lane in range(16)])
    field = code.builder.and_(code.builder.lshr(words, shifts), broadcast(code, mask, I16))
    return code.builder.sitofp(field, F16.llvm)


@operation(F16(F16))
def power_of_two(code: Code, exponents: Any) -> Any:
    """Return 2 to the power of each float32 lane, which must be a whole number from -126 to 127."""
    biased = code.builder.add(code.builder.fptosi(exponents, I16.llvm), broadcast(code, INT(127), I16))
    return code.builder.bitcast(code.builder.shl(biased, broadcast(code, INT(23), I16)), F16.llvm)


@operation(I16(F16))
def one_bit(code: Code, places: Any) -> Any:
    """Return 16 int32 lanes with one bit set in each, at an index given for each lane.

    places : the indices, float32, from 0 to 31 after truncation
    """
    return code.builder.shl(broadcast(code, INT(1), I16), code.builder.fptosi(places, I16.llvm))


def _selection(mask: Any, a: Any, b: Any) -> Any:
    """Return the Numba signature of `select`, in which a or b may be a number."""
    vector = a if isinstance(a, Vector) else b
    return vector(mask, vector, vector)


@operation(_selection)
def select(code: Code, mask: Any, a: Any, b: Any) -> Any:
    """Return a vector with the lane of a where the mask is set, else the lane of b."""
    return code.builder.select(mask, a, b)


@operation(lambda mask: types.int64(mask))
def bits(code: Code, mask: Any) -> Any:
    """Return a mask of lanes as an integer, lane 0 in the lowest bit."""
    word = code.builder.bitcast(mask, ir.IntType(code.types.args[0].lanes))
    return code.builder.zext(word, ir.IntType(64))


@operation(Vector("mask", 16)(types.int64))
def mask16(code: Code, word: Any) -> Any:
    """Return the lowest 16 bits of an integer as a mask of 16 lanes, the lowest bit in lane 0."""
    return code.builder.bitcast(code.builder.trunc(word, ir.IntType(16)), ir.VectorType(ir.IntType(1), 16))


_WHOLE: dict[Any, Any] = {types.float32: types.int32(types.float32), types.float64: types.int64(types.float64)}


@operation(_WHOLE.get)
def float_bits(code: Code, value: Any) -> Any:
    """Return the bits of a float32 as an int32, of a float64 as an int64."""
    return code.builder.bitcast(value, ir.IntType(code.types.return_type.bitwidth))


@operation(types.int64(types.int64))
def count_bits(code: Code, word: Any) -> Any:
    """Count the set bits of an integer of 64 bits."""
    return code.builder.ctpop(word)


@operation(types.int64(types.int64))
def count_trailing_zeros(code: Code, word: Any) -> Any:
    """Return the index of the lowest set bit of an integer, which must not be 0."""
    return code.builder.cttz(word, ir.Constant(ir.IntType(1), 1))


@operation(lambda vector, index: vector.scalar(vector, types.int64))
def lane(code: Code, vector: Any, index: Any) -> Any:
    """Return one lane of a vector as a number. index : of the lane, from 0"""
    return code.builder.extract_element(vector, index)


def _reduce(code: Code, name: str, vector: Any) -> Any:
    """Emit a reduction of all lanes of a vector to one float32.

    code : where LLVM instructions are emitted; name : fmin or fmax
    """
    kind = code.types.args[0]
    called = ir.FunctionType(ir.FloatType(), [kind.llvm])
    name = f"llvm.vector.reduce.{name}.v{kind.lanes}f32"
    function = cgutils.get_or_insert_function(code.builder.module, called, name)
    return code.builder.call(function, [vector], fastmath=("nnan", "nsz"))


@operation(lambda vector: types.float32(vector))
def reduce_min(code: Code, vector: Any) -> Any:
    """Return the least lane; no lane may be NaN."""
    return _reduce(code, "fmin", vector)


@operation(lambda vector: types.float32(vector))
def reduce_max(code: Code, vector: Any) -> Any:
    """Return the greatest lane; no lane may be NaN."""
    return _reduce(code, "fmax", vector)


def _fold(code: Code, value: Any, steps: tuple[int, ...]) -> Any:
    """Emit sums of lanes: for each step in turn, add to lane k of a vector of 16 the lane k ^ step.

    Long steps come first: where a register holds 8 or 4 lanes they add registers, without a shuffle.

    code : where LLVM instructions are emitted
    """
    for step in steps:
        swapped = shuffle(code, value, value, [lane ^ step for lane in range(16)])
        value = code.builder.fadd(value, swapped, flags=FLAGS)
    return value


@operation(F16(F16))
def sum_over_quarters(code: Code, vector: Any) -> Any:
    """Add the four quarters lane by lane; repeat the sum in all of them."""
    return _fold(code, vector, (8, 4))


@operation(F16(F16))
def sum_over_lanes(code: Code, vector: Any) -> Any:
    """Add all lanes; repeat the sum in all of them."""
    return _fold(code, vector, (8, 4, 2, 1))


def _repeat_quarter(code: Code, vector: Any, quarter: int) -> Any:
    """Emit code for a vector of 16 that repeats one quarter (four lanes), 0 to 3, of another.

    code : where LLVM instructions are emitted
    """
    return shuffle(code, vector, vector, [4 * quarter + lane % 4 for lane in range(16)])


@operation(F16(F16))
def first_quarter(code: Code, vector: Any) -> Any:
    """Repeat the first quarter in all four."""
    return _repeat_quarter(code, vector, 0)


@operation(F16(F16))
def third_quarter(code: Code, vector: Any) -> Any:
    """Repeat the third quarter in all four."""
    return _repeat_quarter(code, vector, 2)


@operation(F16(F16))
def last_quarter(code: Code, vector: Any) -> Any:
    """Repeat the last quarter in all four."""
    return _repeat_quarter(code, vector, 3)


@operation(F16(F16, F16))
def shift_lane(code: Code, before: Any, vector: Any) -> Any:
    """Shift a vector of 16 up by one lane; the last lane of `before`, another vector, becomes the first."""
    return shuffle(code, before, vector, range(15, 31))


@operation(F16(F16, F16))
def shift_quarter(code: Code, before: Any, vector: Any) -> Any:
    """Shift a vector of 16 up by four lanes; the last four lanes of `before` become the first.

    With four rays in the lanes of a quarter, and a sample of each in every quarter, each sample gets its predecessor.
    """
    return shuffle(code, before, vector, range(12, 28))


@operation(lambda vector: types.UniTuple(vector, 4)(vector))
def columns(code: Code, vector: Any) -> Any:
    """Return four vectors of 16: lanes 0, 4, 8, 12 of the vector, repeated in every quarter; then 1, 5, 9, 13, etc."""
    parts = [shuffle(code, vector, vector, [lane % 4 * 4 + k for lane in range(16)]) for k in range(4)]
    return code.context.make_tuple(code.builder, code.types.return_type, parts)


@operation(F16(F16, F16, F16, F16))
def sums_of_fours(code: Code, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return a vector of 16: each quarter (four lanes) has four sums, over its own lanes of a, of b, of c and of d."""
    even = [lane // 4 * 4 + lane % 2 * 2 + lane % 4 // 2 * 16 for lane in range(16)]
    odd = [k + 1 for k in even]

    def pairs(x: Any, y: Any) -> Any:
        return code.builder.fadd(shuffle(code, x, y, even), shuffle(code, x, y, odd), flags=FLAGS)

    return pairs(pairs(a, b), pairs(c, d))
