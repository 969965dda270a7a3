"""Loads of vectors from arrays, and stores. With POINTRAY_CHECK=1 each access is checked."""

from __future__ import annotations

from typing import Any

import llvmlite.ir as ir
from numba.core import cgutils, types

from ..jit.decorators import inline
from ..jit.disk_cache import cpu_features
from ..jit.intrinsics import Code, item_pointer, operation
from ..jit.library import CHECK
from .lanes import bits, count_bits, count_trailing_zeros, lane
from .vector import D8, F4, F8, F16, I16, INT, Vector, broadcast, shuffle


def _vector_pointer(code: Code, array: Any, index: Any, vector: Vector) -> Any:
    """Emit code for the address of array[index] as that of a vector.

    code : where LLVM instructions are emitted; array : the first argument of the call
    """
    return code.builder.bitcast(item_pointer(code, 0, (array, index)), vector.llvm.as_pointer())


def _loader(vector: Vector, doc: str) -> Any:
    @operation(lambda array, index: vector(array, types.intp))
    def raw(code: Code, array: Any, index: Any) -> Any:
        return code.builder.load(_vector_pointer(code, array, index, vector), align=4)

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


@operation(lambda array, index, vector: types.none(array, types.intp, vector))
def _store(code: Code, array: Any, index: Any, vector: Any) -> None:
    code.builder.store(vector, _vector_pointer(code, array, index, code.types.args[2]), align=4)


@operation(lambda array, index: types.none(array, types.intp))
def prefetch(code: Code, array: Any, index: Any) -> None:
    """Ask the processor to load the cache line of array[index] into its cache; an index out of range does no harm."""
    pointer = code.builder.bitcast(item_pointer(code, 0, (array, index)), ir.IntType(8).as_pointer())
    kind = ir.FunctionType(ir.VoidType(), [pointer.type, INT, INT, INT])
    function = cgutils.get_or_insert_function(code.builder.module, kind, "llvm.prefetch.p0i8")
    code.builder.call(function, [pointer, INT(0), INT(3), INT(1)])


@operation(lambda vector: types.intp(vector))
def _width(code: Code, vector: Any) -> Any:
    """Return the number of lanes of a vector, a constant when compiling."""
    return code.context.get_constant(types.intp, code.types.args[0].lanes)


@inline
def store(array: Any, index: Any, vector: Any) -> None:
    """Store each lane of a vector in a flat array: array[index + k] = lane k."""
    if CHECK:
        _check(array, index, _width(vector))
    _store(array, index, vector)


@operation(lambda array, index: F16(array, types.intp))
def _broadcast_from(code: Code, array: Any, index: Any) -> Any:
    return broadcast(code, code.builder.load(item_pointer(code, 0, (array, index))), F16)


@inline
def broadcast_from(array: Any, index: Any) -> Any:
    """Return a vector of 16 with array[index] in all lanes, loaded by the instruction that uses it.

    index : not negative
    """
    if CHECK:
        _check(array, index, 1)
    return _broadcast_from(array, index)


@operation(F16(F4))
def _each_quarter(code: Code, four: Any) -> Any:
    return shuffle(code, four, four, [lane % 4 for lane in range(16)])


@inline
def repeat4(array: Any, index: Any) -> Any:
    """Return a vector of 16 that repeats array[index : index + 4] in each quarter (four lanes), with one load."""
    return _each_quarter(load4(array, index))


@operation(lambda array, index, indices: F16(array, types.intp, F16))
def _permute(code: Code, array: Any, index: Any, indices: Any) -> Any:
    builder = code.builder
    where = builder.fptosi(indices, ir.VectorType(INT, 16))
    pointer = _vector_pointer(code, array, index, F16)
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


@operation(F16(F4, F4, F4, F4))
def _join4(code: Code, a: Any, b: Any, c: Any, d: Any) -> Any:
    low, high = (shuffle(code, x, y, range(8)) for x, y in ((a, b), (c, d)))
    return shuffle(code, low, high, range(16))


@inline
def join4(array: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return a vector of 16 with array[a : a + 4] in lanes 0 to 3, array[b : b + 4] in lanes 4 to 7, and so on."""
    return _join4(load4(array, a), load4(array, b), load4(array, c), load4(array, d))


@operation(F8(F4, F4))
def _join2(code: Code, a: Any, b: Any) -> Any:
    return shuffle(code, a, b, range(8))


@inline
def join2(array: Any, a: Any, b: Any) -> Any:
    """Return a vector of 8 with array[a : a + 4] in lanes 0 to 3 and array[b : b + 4] in lanes 4 to 7."""
    return _join2(load4(array, a), load4(array, b))


@inline
def move4(source: Any, index: Any, target: Any, start: Any) -> None:
    """Copy source[index : index + 4] to target[start : start + 4], both flat float32, with one load and one store."""
    store(target, start, load4(source, index))


@operation(lambda mask, vector: vector(mask, vector))
def _compress(code: Code, mask: Any, vector: Any) -> Any:
    kind = code.types.return_type.llvm
    name = f"llvm.experimental.vector.compress.v16{'f32' if code.types.return_type.kind == 'float' else 'i32'}"
    called = ir.FunctionType(kind, [kind, mask.type, kind])
    compress = cgutils.get_or_insert_function(code.builder.module, called, name)
    return code.builder.call(compress, [vector, mask, ir.Constant(kind, ir.Undefined)])


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
