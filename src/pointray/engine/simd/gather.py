"""Loads of vectors from 16 places of an array. With POINTRAY_CHECK=1 each access is checked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import llvmlite.ir as ir
from numba.core import types

from ..jit.decorators import inline
from ..jit.intrinsics import Code, item_pointer, operation
from ..jit.library import CHECK
from .vector import F8, F16, INT, shuffle

# Steps of a transposition: the low and high pairs of two vectors in each quarter, interleaved singly and in twos.
_LOW, _HIGH = ([4 * (k // 4) + first + k % 4 // 2 + 16 * (k % 2) for k in range(16)] for first in (0, 2))
_LOW2, _HIGH2 = ([4 * (k // 4) + first + k % 2 + 16 * (k % 4 // 2) for k in range(16)] for first in (0, 2))
_EVEN, _ODD = ([4 * quarter + k for quarter in (p, p + 2, p + 4, p + 6) for k in range(4)] for p in (0, 1))


def _pointers(code: Code, values: tuple[Any, ...], size: int) -> list[Any]:
    """Emit code for the addresses of 16 items of a flat array, one for each lane, and return these LLVM values.

    code : where LLVM instructions are emitted
    values : LLVM values of the array, of an index array, of start and of stride
    size : numbers per item; the item of lane k begins at array[size * index[start + k * stride]]
    """
    array, index, start, stride = values
    builder, found = code.builder, []
    for lane in range(16):
        place = builder.add(start, builder.mul(stride, ir.Constant(stride.type, lane)))
        row = builder.sext(builder.load(item_pointer(code, 1, (index, place))), ir.IntType(64))
        found.append(item_pointer(code, 0, (array, builder.mul(row, ir.Constant(ir.IntType(64), size)))))
    return found


def _load_each(code: Code, pointers: list[Any]) -> Any:
    """Emit code for a vector of the numbers at 16 addresses.

    code : where LLVM instructions are emitted; pointers : LLVM values of the addresses
    """
    out = ir.Constant(F16.llvm, ir.Undefined)
    for lane, pointer in enumerate(pointers):
        out = code.builder.insert_element(out, code.builder.load(pointer), INT(lane))
    return out


@operation(lambda array, index, start, stride: F16(array, index, types.intp, types.intp))
def _gather16(code: Code, array: Any, index: Any, start: Any, stride: Any) -> Any:
    return _load_each(code, _pointers(code, (array, index, start, stride), 1))


@operation(lambda table, index, start, stride: types.UniTuple(F16, 8)(table, index, types.intp, types.intp))
def _gather_rows8(code: Code, table: Any, index: Any, start: Any, stride: Any) -> Any:
    builder, eight = code.builder, F8.llvm.as_pointer()
    pointers = _pointers(code, (table, index, start, stride), 8)
    rows = [builder.load(builder.bitcast(pointer, eight), align=4) for pointer in pointers]

    def pair(a: Any, b: Any, lanes: Sequence[int]) -> Any:
        return shuffle(code, a, b, lanes)

    # Pair rows k and k + 4, k from 0 to 3 and from 8 to 11; then transpose each quarter of four rows.
    halves: list[list[Any]] = []
    for first in (0, 8):
        a, b, c, d = (pair(rows[k], rows[k + 4], range(16)) for k in range(first, first + 4))
        low, high = (pair(a, b, _LOW), pair(c, d, _LOW)), (pair(a, b, _HIGH), pair(c, d, _HIGH))
        halves.append([pair(two[0], two[1], lanes) for two in (low, high) for lanes in (_LOW2, _HIGH2)])
    columns = [pair(a, b, lanes) for lanes in (_EVEN, _ODD) for a, b in zip(*halves, strict=True)]
    return code.context.make_tuple(builder, code.types.return_type, columns)


@operation(lambda array, start, stride: F16(array, types.intp, types.intp))
def _load_apart16(code: Code, array: Any, start: Any, stride: Any) -> Any:
    places = [code.builder.add(start, code.builder.mul(stride, ir.Constant(stride.type, k))) for k in range(16)]
    return _load_each(code, [item_pointer(code, 0, (array, place)) for place in places])


@inline
def load_apart16(array: Any, start: Any, stride: Any) -> Any:
    """Return a vector of 16 with array[start + k * stride] in lane k. array : flat float32"""
    if CHECK and (start < 0 or stride < 0 or start + 15 * stride >= array.size):
        raise IndexError("vector access outside its array")
    return _load_apart16(array, start, stride)


@inline
def _check(array: Any, size: Any, index: Any, start: Any, stride: Any) -> None:
    """Raise IndexError if one of 16 lanes of a gather would read outside `array`, or outside the array `index`.

    Lane k reads `size` numbers of `array`, from size * index[start + k * stride] on.
    """
    for k in range(16):
        place = start + k * stride
        if place < 0 or place >= index.size:
            raise IndexError("position of a gather index is outside the index array")
        if index[place] < 0 or size * (index[place] + 1) > array.size:
            raise IndexError("gather outside its array")


@inline
def gather16(array: Any, index: Any, start: Any, stride: Any) -> Any:
    """Return a vector of 16 with array[index[start + k * stride]] in lane k.

    array : flat float32; index : flat int32
    """
    if CHECK:
        _check(array, 1, index, start, stride)
    return _gather16(array, index, start, stride)


@inline
def gather_rows8(table: Any, index: Any, start: Any, stride: Any) -> Any:
    """Load 16 rows of a flat float32 table with eight columns; return eight vectors, one for each column.

    Lane k has row index[start + k * stride]. index : flat int32
    """
    if CHECK:
        _check(table, 8, index, start, stride)
    return _gather_rows8(table, index, start, stride)
