"""Loads of vectors from arrays, and stores. With POINTRAY_CHECK=1 each access is checked."""

from __future__ import annotations

from typing import Any

import llvmlite.ir as ir
from numba.core import cgutils, types

from ..jit.decorators import inline
from ..jit.disk_cache import cpu_features
from ..jit.intrinsics import Code, item_pointer, operation
from ..jit.library import CHECK
from .lanes import lane
from .vector import D8, F4, F8, F16, I8, I16, INT, Vector, broadcast, shuffle


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


_FEATURES = cpu_features()
# Lanes of a register, for loops that keep many vectors: 4 on any other processor.
WIDTH = 16 if "+avx512f" in _FEATURES else 8 if "+avx2" in _FEATURES else 4

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


@operation(lambda array, index, like: like(array, types.intp, like))
def _broadcast_like(code: Code, array: Any, index: Any, like: Any) -> Any:
    return broadcast(code, code.builder.load(item_pointer(code, 0, (array, index))), code.types.return_type)


@inline
def broadcast_like(array: Any, index: Any, like: Any) -> Any:
    """Return a vector with array[index] in as many lanes as another vector has. index : not negative"""
    if CHECK:
        _check(array, index, 1)
    return _broadcast_like(array, index, like)


@operation(F16(F4))
def _each_quarter(code: Code, four: Any) -> Any:
    return shuffle(code, four, four, [lane % 4 for lane in range(16)])


@inline
def repeat4(array: Any, index: Any) -> Any:
    """Return a vector of 16 that repeats array[index : index + 4] in each quarter (four lanes), with one load."""
    return _each_quarter(load4(array, index))


@operation(lambda array, index, indices: indices(array, types.intp, indices))
def _look_up(code: Code, array: Any, index: Any, indices: Any) -> Any:
    builder, kind = code.builder, code.types.return_type
    where = builder.fptosi(indices, ir.VectorType(INT, kind.lanes))
    pointer = _vector_pointer(code, array, index, F16)
    if WIDTH == kind.lanes == 16:
        return _permuted(code, "llvm.x86.avx512.permvar.sf.512", builder.load(pointer, align=4), where)
    if WIDTH == kind.lanes == 8:
        table, name = builder.load(pointer, align=4), "llvm.x86.avx2.permps"
        low, high = (_permuted(code, name, shuffle(code, table, table, range(k, k + 8)), where) for k in (0, 8))
        return builder.select(builder.icmp_signed(">", where, broadcast(code, INT(7), I8)), high, low)
    out = ir.Constant(kind.llvm, ir.Undefined)
    first = builder.bitcast(pointer, ir.FloatType().as_pointer())
    for k in range(kind.lanes):
        value = builder.load(builder.gep(first, [builder.extract_element(where, INT(k))]))
        out = builder.insert_element(out, value, INT(k))
    return out


@inline
def look_up(array: Any, index: Any, indices: Any) -> Any:
    """Return a vector with array[index + i] for each lane i of `indices`, float32 from 0 to 15.

    It is fast if the indices fill one register.
    """
    if CHECK:
        _check(array, index, 16)
        for k in range(_width(indices)):
            if not 0 <= lane(indices, k) < 16:
                raise IndexError("index of a table is not from 0 to 15")
    return _look_up(array, index, indices)


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


def _table_of_orders(lanes: int, size: int) -> tuple[str, int, bytes]:
    """Return a table of permutations that move the set lanes of a mask to the front, a row for each mask.

    lanes : of the mask, whose bits are the number of the row
    size : bytes of a lane; the table holds, for each byte of a row, the number of the byte that moves there

    Returns the table's name in LLVM, the bytes of a row, and the table.
    """
    table = bytearray()
    for word in range(1 << lanes):
        order = [k for k in range(lanes) if word >> k & 1]
        order += [0] * (lanes - len(order))
        table += bytes(size * k + byte for k in order for byte in range(size))
    return f"orders_of_{lanes}", lanes * size, bytes(table)


_PERMUTES = any(feature in _FEATURES for feature in ("+avx512f", "+avx2", "+ssse3", "+neon"))
_ORDERS_OF_8, _BYTES_OF_4 = _table_of_orders(8, 1), _table_of_orders(4, 4)


def _row(code: Code, table: tuple[str, int, bytes], row: Any) -> Any:
    """Emit the load of one row of a constant table, and return it as a vector of bytes.

    code : where LLVM instructions are emitted; table : see `_table_of_orders`; row : LLVM value, number of the row
    """
    builder, (name, size, content) = code.builder, table
    if name not in builder.module.globals:
        kind = ir.ArrayType(ir.IntType(8), len(content))
        cgutils.global_constant(builder.module, name, ir.Constant(kind, bytearray(content)))
    first = builder.bitcast(builder.module.globals[name], ir.IntType(8).as_pointer())
    place = builder.gep(first, [builder.mul(row, ir.Constant(row.type, size))])
    return builder.load(builder.bitcast(place, ir.VectorType(ir.IntType(8), size).as_pointer()), align=1)


def _permuted(code: Code, name: str, vector: Any, order: Any) -> Any:
    """Emit a permutation of a vector by an instruction of the processor, and return the LLVM value.

    code : where LLVM instructions are emitted; name : of the function in LLVM; order : LLVM value, a vector of indices
    """
    kind = ir.FunctionType(vector.type, [vector.type, order.type])
    return code.builder.call(cgutils.get_or_insert_function(code.builder.module, kind, name), [vector, order])


def _pack_register(code: Code, mask: Any, vector: Any, kind: Vector) -> Any:
    """Emit code that moves the lanes of a vector that are set in a mask to the front; return the LLVM value.

    code : where LLVM instructions are emitted; kind : type of the vector, which has `WIDTH` lanes
    """
    builder, is_float = code.builder, kind.kind == "float"
    if WIDTH == 16:
        name = f"llvm.experimental.vector.compress.v16{'f32' if is_float else 'i32'}"
        called = ir.FunctionType(kind.llvm, [kind.llvm, mask.type, kind.llvm])
        compress = cgutils.get_or_insert_function(builder.module, called, name)
        return builder.call(compress, [vector, mask, ir.Constant(kind.llvm, ir.Undefined)])
    word = builder.zext(builder.bitcast(mask, ir.IntType(WIDTH)), ir.IntType(64))
    if WIDTH == 8:
        order = builder.zext(_row(code, _ORDERS_OF_8, word), ir.VectorType(INT, 8))
        return _permuted(code, f"llvm.x86.avx2.perm{'ps' if is_float else 'd'}", vector, order)
    order = _row(code, _BYTES_OF_4, word)
    name = "llvm.aarch64.neon.tbl1.v16i8" if "+neon" in _FEATURES else "llvm.x86.ssse3.pshuf.b.128"
    return builder.bitcast(_permuted(code, name, builder.bitcast(vector, order.type), order), kind.llvm)


def _store_each(code: Code, mask: Any, vector: Any, target: Any, start: Any) -> Any:
    """Emit `_store_packed` for processors without a permutation by a table; return the LLVM value behind the last."""
    builder = code.builder
    for k in range(code.types.args[1].lanes):
        value = builder.extract_element(vector, INT(k))
        builder.store(value, item_pointer(code, 2, (target, start)))
        start = builder.add(start, builder.zext(builder.extract_element(mask, INT(k)), start.type))
    return start


@operation(lambda mask, vector, target, start: types.int64(mask, vector, target, types.intp))
def _store_packed(code: Code, mask: Any, vector: Any, target: Any, start: Any) -> Any:
    builder, kind = code.builder, code.types.args[1]
    register, first = Vector(kind.kind, WIDTH), start
    if not _PERMUTES:
        return builder.sub(_store_each(code, mask, vector, target, start), first)
    for k in range(0, kind.lanes, WIDTH):
        one = shuffle(code, mask, mask, range(k, k + WIDTH))
        packed = _pack_register(code, one, shuffle(code, vector, vector, range(k, k + WIDTH)), register)
        # All lanes are stored: a compressing store is slow on some processors.
        pointer = builder.bitcast(item_pointer(code, 2, (target, start)), register.llvm.as_pointer())
        builder.store(packed, pointer, align=4)
        count = builder.ctpop(builder.bitcast(one, ir.IntType(WIDTH)))
        start = builder.add(start, builder.zext(count, start.type))
    return builder.sub(start, first)


@inline
def store_packed(target: Any, start: Any, mask: Any, vector: Any) -> int:
    """Store the set lanes of a float32 or int32 vector in target[start:], consecutively; return their number.

    As many items of `target` as the vector has lanes may be overwritten.
    """
    if CHECK:
        _check(target, start, _width(vector))
    return _store_packed(mask, vector, target, start)


@operation(lambda array, index, mask: Vector("int", mask.lanes)(array, types.intp, mask))
def _load_int(code: Code, array: Any, index: Any, mask: Any) -> Any:
    """Load as many items of an int32 array as a mask has lanes."""
    return code.builder.load(_vector_pointer(code, array, index, code.types.return_type), align=4)


@inline
def pack(mask: Any, source: Any, index: Any, target: Any, start: Any) -> int:
    """Copy source[index + k] for each set lane k of a mask to target[start:], and return their number.

    Both arrays are flat int32. As many items of `target` as the mask has lanes may be overwritten.
    """
    if CHECK:
        _check(source, index, _width(mask))
    return store_packed(target, start, mask, _load_int(source, index, mask))


@inline
def register_lanes() -> int:
    """Return how many float32 a register of the processor holds: 16, 8 or 4; a constant when compiling."""
    return WIDTH


@operation(Vector("mask", WIDTH)(types.int64))
def mask_register(code: Code, word: Any) -> Any:
    """Return the lowest bits of an integer as a mask of the lanes of a register, the lowest bit in lane 0."""
    return code.builder.bitcast(code.builder.trunc(word, ir.IntType(WIDTH)), ir.VectorType(ir.IntType(1), WIDTH))


load_register = _loader(Vector("float", WIDTH), "Load array[index + lane] of a flat float32 array into one register.")
