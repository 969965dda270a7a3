"""Loads of vectors from arrays, and stores. With POINTRAY_CHECK=1 each access is checked."""

from __future__ import annotations

from typing import Any

import llvmlite.ir as ir
from numba.core import cgutils, types

from ..jit.decorators import inline
from ..jit.disk_cache import cpu_features
from ..jit.intrinsics import intrinsic
from ..jit.library import CHECK
from .lanes import bits, count_bits, count_trailing_zeros, lane
from .vector import D8, F4, F8, F16, I16, INT, Vector, broadcast, shuffle


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any, vector: Vector) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), vector.llvm.as_pointer())


def _loader(vector: Vector, doc: str) -> Any:
    def read(typingctx: Any, array: Any, index: Any) -> Any:
        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            pointer = _pointer(context, builder, sig.args[0], args[0], args[1], vector)
            return builder.load(pointer, align=4)

        return vector(array, types.intp), codegen

    raw = intrinsic(read)
    lanes = vector.lanes

    def load(array: Any, index: Any) -> Any:
        if CHECK:
            _check(array, index, lanes)
        return raw(array, index)

    load.__doc__ = doc
    return inline(load)


@inline
def _check(array: Any, index: Any, lanes: Any) -> None:
    """Raise IndexError if array[index : index + lanes] is not within a flat array."""
    if index < 0 or index + lanes > array.size:
        raise IndexError("vector access outside its array")


PACKS = "+avx512f" in cpu_features()  # one instruction packs lanes; other processors loop over the set bits

load8 = _loader(F8, "Load array[index + lane] of a flat float32 array into lanes 0..7.")
load16 = _loader(F16, "Load array[index + lane] of a flat float32 array into lanes 0..15.")
load8_double = _loader(D8, "Load array[index + lane] of a flat float64 array into lanes 0..7.")
load16_int = _loader(I16, "Load array[index + lane] of a flat int32 array into lanes 0..15.")
load4 = _loader(F4, "Load array[index + lane] of a flat float32 array into lanes 0..3.")


@intrinsic
def _store(typingctx: Any, array: Any, index: Any, vector: Any) -> Any:
    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        builder.store(args[2], _pointer(context, builder, sig.args[0], args[0], args[1], sig.args[2]), align=4)
        return context.get_dummy_value()

    return types.none(array, types.intp, vector), codegen


@intrinsic
def prefetch(typingctx: Any, array: Any, index: Any) -> Any:
    """Ask the processor to load the cache line of array[index] into its cache; an index out of range does no harm."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        pointer = builder.bitcast(builder.gep(data, [args[1]]), ir.IntType(8).as_pointer())
        kind = ir.FunctionType(ir.VoidType(), [pointer.type, INT, INT, INT])
        ask = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")
        builder.call(ask, [pointer, INT(0), INT(3), INT(1)])
        return context.get_dummy_value()

    return types.none(array, types.intp), codegen


@intrinsic
def _width(typingctx: Any, vector: Any) -> Any:
    """Return the number of lanes of a vector, a constant when compiling."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return context.get_constant(types.intp, sig.args[0].lanes)

    return types.intp(vector), codegen


@inline
def store(array: Any, index: Any, vector: Any) -> None:
    """Store each lane of a vector in a flat array: array[index + k] = lane k."""
    if CHECK:
        _check(array, index, _width(vector))
    _store(array, index, vector)


@intrinsic
def _broadcast_from(typingctx: Any, array: Any, index: Any) -> Any:
    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return broadcast(builder, builder.load(builder.gep(data, [args[1]])), F16)

    return F16(array, types.intp), codegen


@inline
def broadcast_from(array: Any, index: Any) -> Any:
    """Return a vector of 16 with array[index] in all lanes, loaded by the instruction that uses it.

    index : not negative
    """
    if CHECK:
        _check(array, index, 1)
    return _broadcast_from(array, index)


@intrinsic
def _each_quarter(typingctx: Any, four: Any) -> Any:
    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return shuffle(builder, args[0], args[0], [lane % 4 for lane in range(16)])

    return F16(F4), codegen


@inline
def repeat4(array: Any, index: Any) -> Any:
    """Return a vector of 16 that repeats array[index : index + 4] in each quarter (four lanes), with one load."""
    return _each_quarter(load4(array, index))


@intrinsic
def _permute(typingctx: Any, array: Any, index: Any, indices: Any) -> Any:
    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        where = builder.fptosi(args[2], ir.VectorType(INT, 16))
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1], F16)
        if PACKS:
            kind = ir.FunctionType(F16.llvm, [F16.llvm, where.type])
            permute = cgutils.get_or_insert_function(builder.module, kind, "llvm.x86.avx512.permvar.sf.512")
            return builder.call(permute, [builder.load(pointer, align=4), where])
        out = ir.Constant(F16.llvm, ir.Undefined)
        first = builder.bitcast(pointer, ir.FloatType().as_pointer())
        for k in range(16):
            value = builder.load(builder.gep(first, [builder.extract_element(where, INT(k))]))
            out = builder.insert_element(out, value, INT(k))
        return out

    return F16(array, types.intp, F16), codegen


@inline
def permute16(array: Any, index: Any, indices: Any) -> Any:
    """Return a vector of 16 with array[index + i] for each lane i of `indices`, which are float32 from 0 to 15."""
    if CHECK:
        _check(array, index, 16)
        _check_indices(indices)
    return _permute(array, index, indices)


@inline
def _check_indices(indices: Any) -> None:
    """Raise IndexError if a lane of a permutation's indices is not from 0 to 15."""
    for k in range(16):
        if not 0 <= lane(indices, k) < 16:
            raise IndexError("index of a permutation is not from 0 to 15")


@intrinsic
def _join4(typingctx: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        low, high = (shuffle(builder, args[k], args[k + 1], list(range(8))) for k in (0, 2))
        return shuffle(builder, low, high, list(range(16)))

    return F16(F4, F4, F4, F4), codegen


@inline
def join4(array: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return a vector of 16 with array[a : a + 4] in lanes 0 to 3, array[b : b + 4] in lanes 4 to 7, and so on."""
    return _join4(load4(array, a), load4(array, b), load4(array, c), load4(array, d))


@intrinsic
def _join2(typingctx: Any, a: Any, b: Any) -> Any:
    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return shuffle(builder, args[0], args[1], list(range(8)))

    return F8(F4, F4), codegen


@inline
def join2(array: Any, a: Any, b: Any) -> Any:
    """Return a vector of 8 with array[a : a + 4] in lanes 0 to 3 and array[b : b + 4] in lanes 4 to 7."""
    return _join2(load4(array, a), load4(array, b))


@inline
def move4(source: Any, index: Any, target: Any, start: Any) -> None:
    """Copy source[index : index + 4] to target[start : start + 4], both flat float32, with one load and one store."""
    store(target, start, load4(source, index))


@intrinsic
def _compress(typingctx: Any, mask: Any, vector: Any) -> Any:
    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = sig.return_type.llvm
        name = f"llvm.experimental.vector.compress.v16{'f32' if sig.return_type.kind == 'float' else 'i32'}"
        compress = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(kind, [kind, args[0].type, kind]), name
        )
        return builder.call(compress, [args[1], args[0], ir.Constant(kind, ir.Undefined)])

    return vector(mask, vector), codegen


@inline
def pack(mask: Any, source: Any, index: Any, target: Any, start: Any) -> int:
    """Copy source[index + k] for each set lane k of a mask of 16 to target[start:], and return their number.

    Both arrays are flat int32. All of target[start : start + 16] may be overwritten.
    """
    if CHECK:
        _check(source, index, 16)
        _check(target, start, 16)
    if PACKS:
        # All 16 lanes are stored: a compressing store is slow on some processors.
        _store(target, start, _compress(mask, load16_int(source, index)))
        return count_bits(bits(mask))
    left, n = bits(mask), 0
    while left != 0:
        target[start + n] = source[index + count_trailing_zeros(left)]
        n += 1
        left &= left - 1
    return n


@inline
def store_packed(target: Any, start: Any, mask: Any, vector: Any) -> None:
    """Store the set lanes of a float32 vector in target[start:], consecutively.

    All of target[start : start + 16] may be overwritten. mask : of 16 lanes
    """
    if PACKS:
        store(target, start, _compress(mask, vector))
        return
    left, n = bits(mask), 0
    while left != 0:
        target[start + n] = lane(vector, count_trailing_zeros(left))
        n += 1
        left &= left - 1
