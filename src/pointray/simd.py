"""The vector type of the kernels: `lanes` numbers that one instruction handles together.

Vectors are LLVM's own (<16 x float>, <8 x float>, <4 x float>, <16 x i32>); LLVM splits them into what the processor
has. A comparison gives a mask, `bits` turns a mask into an integer whose set bits are walked with `lowest`.
Arithmetic with a scalar spreads the scalar over all lanes.
"""

from __future__ import annotations

import operator
from typing import Any

import llvmlite.ir as ir
from numba.core import cgutils, types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, lower_cast, models, register_model

from .jit import CHECK, cpu_features, inline, intrinsic

_FLAGS = ("nsz", "arcp", "contract", "afn")
_I32 = ir.IntType(32)


class Vector(types.Type):
    """Numba type of `lanes` float32, int32 or truth values."""

    def __init__(self, kind: str, lanes: int) -> None:
        self.kind, self.lanes = kind, lanes
        super().__init__(name=f"{kind}x{lanes}")  # type: ignore[no-untyped-call]

    @property
    def element(self) -> Any:
        return {"float": ir.FloatType(), "int": _I32, "mask": ir.IntType(1)}[self.kind]

    @property
    def llvm(self) -> Any:
        return ir.VectorType(self.element, self.lanes)


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, dmm: Any, fe_type: Vector) -> None:
        super().__init__(dmm, fe_type, fe_type.llvm)  # type: ignore[no-untyped-call]


def _spread(builder: Any, value: Any, vector: Vector) -> Any:
    """The scalar in every lane."""
    one = builder.insert_element(ir.Constant(vector.llvm, ir.Undefined), value, _I32(0))
    zeros = ir.Constant(ir.VectorType(_I32, vector.lanes), [0] * vector.lanes)
    return builder.shuffle_vector(one, one, zeros)


def _shuffle(builder: Any, a: Any, b: Any, lanes: list[int]) -> Any:
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_I32, len(lanes)), lanes))


@lower_cast(types.Number, Vector)
def _number_to_vector(context, builder, fromty, toty, value):  # type: ignore[no-untyped-def]
    scalar = types.float32 if toty.kind == "float" else types.int32
    return _spread(builder, context.cast(builder, value, fromty, scalar), toty)


def _binary(op: Any, kinds: tuple[str, ...], emit: Any, to_mask: bool = False) -> None:
    """Register one operator for vectors, and for a vector with a number."""

    class Template(AbstractTemplate):  # type: ignore[misc]
        def generic(self, args, kws):  # type: ignore[no-untyped-def]
            vectors = [a for a in args if isinstance(a, Vector)]
            if not vectors or vectors[0].kind not in kinds:
                return None
            vector = vectors[0]
            if any(not (a == vector or (isinstance(a, types.Number) and vector.kind != "mask")) for a in args):
                return None
            result = Vector("mask", vector.lanes) if to_mask else vector
            return signature(result, vector, vector)

    infer_global(op)(Template)

    @lower_builtin(op, Vector, Vector)
    def lower(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return emit(builder, sig.args[0].kind, *args)


def _arithmetic(float_op: str, int_op: str | None) -> Any:
    def emit(builder: Any, kind: str, a: Any, b: Any) -> Any:
        if kind == "float":
            return getattr(builder, float_op)(a, b, flags=_FLAGS)
        return getattr(builder, str(int_op))(a, b)

    return emit


def _compare(symbol: str) -> Any:
    def emit(builder: Any, kind: str, a: Any, b: Any) -> Any:
        if kind == "float":
            return builder.fcmp_ordered(symbol, a, b)
        return builder.icmp_signed(symbol, a, b)

    return emit


_binary(operator.add, ("float", "int"), _arithmetic("fadd", "add"))
_binary(operator.sub, ("float", "int"), _arithmetic("fsub", "sub"))
_binary(operator.mul, ("float", "int"), _arithmetic("fmul", "mul"))
_binary(operator.truediv, ("float",), _arithmetic("fdiv", None))
for _op, _symbol in ((operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">=")):
    _binary(_op, ("float", "int"), _compare(_symbol), to_mask=True)
_binary(operator.and_, ("mask",), lambda builder, kind, a, b: builder.and_(a, b))
_binary(operator.or_, ("mask",), lambda builder, kind, a, b: builder.or_(a, b))
_binary(operator.xor, ("mask",), lambda builder, kind, a, b: builder.xor(a, b))


# ----------------------------------------------------------------------------------------------- loads and stores


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any, vector: Vector) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), vector.llvm.as_pointer())


def _loader(vector: Vector, doc: str) -> Any:
    def raw(typingctx, array, index):  # type: ignore[no-untyped-def]
        def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
            pointer = _pointer(context, builder, sig.args[0], args[0], args[1], vector)
            return builder.load(pointer, align=4)

        return vector(array, types.intp), codegen

    raw = intrinsic(raw)
    lanes = vector.lanes

    def load(array, index):  # type: ignore[no-untyped-def]
        if CHECK:
            _check(array, index, lanes)
        return raw(array, index)

    load.__doc__ = doc
    return inline(load)


@inline
def _check(array, index, lanes):  # type: ignore[no-untyped-def]
    """Raise where a vector would be read or written outside of the array."""
    if index < 0 or index + lanes > array.size:
        raise IndexError("a vector reaches beyond its array")


F4, F8, F16 = Vector("float", 4), Vector("float", 8), Vector("float", 16)
load8 = _loader(F8, "Lanes 0..7: array[index + lane] of a flat float32 array.")
load16 = _loader(F16, "Lanes 0..15: array[index + lane] of a flat float32 array.")
_load4 = _loader(F4, "Lanes 0..3: array[index + lane] of a flat float32 array.")


@intrinsic
def _store(typingctx, array, index, vector):  # type: ignore[no-untyped-def]
    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        builder.store(args[2], _pointer(context, builder, sig.args[0], args[0], args[1], sig.args[2]), align=4)
        return context.get_dummy_value()

    return types.none(array, types.intp, vector), codegen


@intrinsic
def prefetch(typingctx, array, index):  # type: ignore[no-untyped-def]
    """Ask for the cache line of array[index], which will be read soon; nothing happens if it does not exist."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        pointer = builder.bitcast(builder.gep(data, [args[1]]), ir.IntType(8).as_pointer())
        kind = ir.FunctionType(ir.VoidType(), [pointer.type, _I32, _I32, _I32])
        ask = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")
        builder.call(ask, [pointer, _I32(0), _I32(3), _I32(1)])
        return context.get_dummy_value()

    return types.none(array, types.intp), codegen


@intrinsic
def lanes(typingctx, vector):  # type: ignore[no-untyped-def]
    """Number of lanes, known when compiling."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return context.get_constant(types.intp, sig.args[0].lanes)

    return types.intp(vector), codegen


@inline
def store(array, index, vector):  # type: ignore[no-untyped-def]
    """array[index + lane] = lane."""
    if CHECK:
        _check(array, index, lanes(vector))
    _store(array, index, vector)


# ----------------------------------------------------------------------------------------------- making vectors


def _maker(vector: Vector, doc: str) -> Any:
    scalar = types.float32 if vector.kind == "float" else types.int32

    def make(typingctx, value):  # type: ignore[no-untyped-def]
        def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
            return _spread(builder, args[0], vector)

        return vector(scalar), codegen

    make.__doc__ = doc
    return intrinsic(make)


@intrinsic
def _spread_from(typingctx, array, index):  # type: ignore[no-untyped-def]
    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return _spread(builder, builder.load(builder.gep(data, [args[1]])), F16)

    return F16(array, types.intp), codegen


@inline
def spread_from(array, index):  # type: ignore[no-untyped-def]
    """array[index] in all 16 lanes: part of the instruction that uses it. (Numba would look for negative indices.)"""
    if CHECK:
        _check(array, index, 1)
    return _spread_from(array, index)


spread8 = _maker(F8, "The number in all 8 lanes.")
spread16 = _maker(F16, "The number in all 16 lanes.")


@intrinsic
def quarters(typingctx, a, b, c, d):  # type: ignore[no-untyped-def]
    """Four numbers, each in the four lanes of one quarter."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        four = ir.Constant(F4.llvm, ir.Undefined)
        for lane, value in enumerate(args):
            four = builder.insert_element(four, value, _I32(lane))
        return _shuffle(builder, four, four, [lane // 4 for lane in range(16)])

    return F16(*[types.float32] * 4), codegen


@intrinsic
def _each_quarter(typingctx, four):  # type: ignore[no-untyped-def]
    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return _shuffle(builder, args[0], args[0], [lane % 4 for lane in range(16)])

    return F16(F4), codegen


@inline
def repeat4(array, index):  # type: ignore[no-untyped-def]
    """array[index : index + 4] in every quarter: one broadcasting load."""
    return _each_quarter(_load4(array, index))


@inline
def move4(source, index, target, at):  # type: ignore[no-untyped-def]
    """target[at : at + 4] = source[index : index + 4]."""
    store(target, at, _load4(source, index))


# ----------------------------------------------------------------------------------------------- lane by lane


def _llvm_binary(name: str, doc: str) -> Any:
    def make(typingctx, a, b):  # type: ignore[no-untyped-def]
        vector = a if isinstance(a, Vector) else b

        def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
            function = cgutils.get_or_insert_function(
                builder.module,
                ir.FunctionType(vector.llvm, [vector.llvm] * 2),
                f"llvm.{name}.v{vector.lanes}f32",
            )
            return builder.call(function, args, fastmath=_FLAGS)

        return vector(vector, vector), codegen

    make.__doc__ = doc
    return intrinsic(make)


@intrinsic
def vmin(typingctx, a, b):  # type: ignore[no-untyped-def]
    """The lesser of each pair of lanes; where one is NaN, the second (one instruction on x86)."""
    return _choose("<", a, b)


@intrinsic
def vmax(typingctx, a, b):  # type: ignore[no-untyped-def]
    """The greater of each pair of lanes; where one is NaN, the second."""
    return _choose(">", a, b)


def _choose(symbol: str, a: Any, b: Any) -> Any:
    vector = a if isinstance(a, Vector) else b

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return builder.select(builder.fcmp_ordered(symbol, *args), *args)

    return vector(vector, vector), codegen


def _llvm_unary(name: str, doc: str) -> Any:
    def make(typingctx, a):  # type: ignore[no-untyped-def]
        def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
            vector = sig.args[0]
            kind = ir.FunctionType(vector.llvm, [vector.llvm])
            function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{vector.lanes}f32")
            return builder.call(function, args)

        return a(a), codegen

    make.__doc__ = doc
    return intrinsic(make)


vabs = _llvm_unary("fabs", "Absolute values.")
vsqrt = _llvm_unary("sqrt", "Square roots; NaN of what is negative.")


@intrinsic
def whole(typingctx, a):  # type: ignore[no-untyped-def]
    """Numbers without their fractions. None may be beyond int32: no call to a library, on any processor."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        vector = sig.args[0]
        return builder.sitofp(builder.fptosi(args[0], ir.VectorType(_I32, vector.lanes)), vector.llvm)

    return a(a), codegen


@intrinsic
def select(typingctx, mask, a, b):  # type: ignore[no-untyped-def]
    """Lane of a where the mask holds, else of b."""
    vector = a if isinstance(a, Vector) else b

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return builder.select(*args)

    return vector(mask, vector, vector), codegen


# ----------------------------------------------------------------------------------------------- across lanes


@intrinsic
def bits(typingctx, mask):  # type: ignore[no-untyped-def]
    """The mask as an integer, lane 0 lowest."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        word = builder.bitcast(args[0], ir.IntType(sig.args[0].lanes))
        return builder.zext(word, ir.IntType(64))

    return types.int64(mask), codegen


@intrinsic
def mask16(typingctx, word):  # type: ignore[no-untyped-def]
    """The lowest 16 bits of an integer as a mask."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        word = builder.trunc(args[0], ir.IntType(16))
        return builder.bitcast(word, ir.VectorType(ir.IntType(1), 16))

    return Vector("mask", 16)(types.int64), codegen


@intrinsic
def count_bits(typingctx, word):  # type: ignore[no-untyped-def]
    """How many bits of an integer are set."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return builder.ctpop(args[0])

    return types.int64(types.int64), codegen


@intrinsic
def lowest(typingctx, word):  # type: ignore[no-untyped-def]
    """Number of the lowest set bit; the word must not be 0."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), codegen


# Whether the processor packs lanes in one instruction; elsewhere the set bits are walked.
PACKS = "+avx512f" in cpu_features()


@intrinsic
def _compress(typingctx, mask, source, index, target, at):  # type: ignore[no-untyped-def]
    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        mask, source, index, target, at = args
        vector = Vector("int", 16)
        values = builder.load(_pointer(context, builder, sig.args[1], source, index, vector), align=4)
        kind = ir.FunctionType(vector.llvm, [vector.llvm, mask.type, vector.llvm])
        compress = cgutils.get_or_insert_function(builder.module, kind, "llvm.experimental.vector.compress.v16i32")
        packed = builder.call(compress, [values, mask, ir.Constant(vector.llvm, ir.Undefined)])
        # All 16 lanes are stored: a compressing store is slow on some processors.
        builder.store(packed, _pointer(context, builder, sig.args[3], target, at, vector), align=4)
        word = builder.bitcast(mask, ir.IntType(16))
        return builder.zext(builder.ctpop(word), ir.IntType(64))

    return types.int64(mask, source, types.intp, target, types.intp), codegen


@inline
def pack(mask, source, index, target, at):  # type: ignore[no-untyped-def]
    """Append source[index + lane] of each set lane of a 16-lane mask to target[at:], int32; returns how many.

    Whatever lies in the 16 places from target[at] on may be overwritten.
    """
    if CHECK:
        _check(source, index, 16)
        _check(target, at, 16)
    if PACKS:
        return _compress(mask, source, index, target, at)
    left, n = bits(mask), 0
    while left != 0:
        target[at + n] = source[index + lowest(left)]
        n += 1
        left &= left - 1
    return n


@intrinsic
def _compressed(typingctx, mask, vector):  # type: ignore[no-untyped-def]
    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        kind = ir.FunctionType(F16.llvm, [F16.llvm, args[0].type, F16.llvm])
        compress = cgutils.get_or_insert_function(builder.module, kind, "llvm.experimental.vector.compress.v16f32")
        return builder.call(compress, [args[1], args[0], ir.Constant(F16.llvm, ir.Undefined)])

    return F16(mask, vector), codegen


@inline
def store_packed(target, at, mask, vector):  # type: ignore[no-untyped-def]
    """Store the set lanes of a float32 vector one after the other; the rest of target[at : at + 16] is undefined."""
    if PACKS:
        store(target, at, _compressed(mask, vector))
        return
    left, n = bits(mask), 0
    while left != 0:
        target[at + n] = lane(vector, lowest(left))
        n += 1
        left &= left - 1


@intrinsic
def lane(typingctx, vector, index):  # type: ignore[no-untyped-def]
    """One lane as a number."""
    scalar = types.float32 if vector.kind == "float" else types.int32

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return builder.extract_element(args[0], args[1])

    return scalar(vector, types.int64), codegen


def _reducer(name: str, doc: str) -> Any:
    def reduce(typingctx, vector):  # type: ignore[no-untyped-def]
        def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
            kind = ir.FunctionType(ir.FloatType(), [vector.llvm])
            function = cgutils.get_or_insert_function(
                builder.module, kind, f"llvm.vector.reduce.{name}.v{vector.lanes}f32"
            )
            return builder.call(function, args, fastmath=("nnan", "nsz"))

        return types.float32(vector), codegen

    reduce.__doc__ = doc
    return intrinsic(reduce)


least = _reducer("fmin", "The least lane; none may be NaN.")
greatest = _reducer("fmax", "The greatest lane; none may be NaN.")


def _folder(steps: tuple[int, int], doc: str) -> Any:
    def fold(typingctx, vector):  # type: ignore[no-untyped-def]
        def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
            value = args[0]
            for step in steps:
                swapped = _shuffle(builder, value, value, [lane ^ step for lane in range(16)])
                value = builder.fadd(value, swapped, flags=_FLAGS)
            return value

        return F16(F16), codegen

    fold.__doc__ = doc
    return intrinsic(fold)


sum_quarters = _folder((1, 2), "The sum of each quarter, in all four of its lanes: two shuffles and two additions.")
sum_over_quarters = _folder((4, 8), "The sum of the four quarters, lane by lane, in all of them.")


def _picker(quarter: int, doc: str) -> Any:
    def pick(typingctx, vector):  # type: ignore[no-untyped-def]
        def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
            return _shuffle(builder, args[0], args[0], [4 * quarter + lane % 4 for lane in range(16)])

        return F16(F16), codegen

    pick.__doc__ = doc
    return intrinsic(pick)


first_quarter = _picker(0, "The first quarter in all four.")
last_quarter = _picker(3, "The last quarter in all four.")


@intrinsic
def shift_quarter(typingctx, before, vector):  # type: ignore[no-untyped-def]
    """The vector moved up by one quarter, the last quarter of `before` coming in: each sample's predecessor."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return _shuffle(builder, args[0], args[1], list(range(12, 28)))

    return F16(F16, F16), codegen


@intrinsic
def reinterpret_int(typingctx, value):  # type: ignore[no-untyped-def]
    """The bits of a float32 as an int32."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return builder.bitcast(args[0], _I32)

    return types.int32(types.float32), codegen
