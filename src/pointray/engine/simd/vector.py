"""The vector type and its operators."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any

import llvmlite.ir as ir
from numba.core import types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, lower_cast, models, register_model

from ..jit.intrinsics import Code

FLAGS = ("nsz", "arcp", "contract", "afn")
INT = ir.IntType(32)


class Vector(types.Type):
    """Numba type of a vector of `lanes` numbers or truth values, which one instruction processes together.

    kind : of its lanes, "float" (float32), "double" (float64), "int" (int32) or "mask" (bool)
    """

    def __init__(self, kind: str, lanes: int) -> None:
        self.kind, self.lanes = kind, lanes
        super().__init__(name=f"{kind}x{lanes}")

    @property
    def element(self) -> Any:
        return {"float": ir.FloatType(), "double": ir.DoubleType(), "int": INT, "mask": ir.IntType(1)}[self.kind]

    @property
    def scalar(self) -> Any:
        """Numba type of one lane of the vector."""
        return {"float": types.float32, "double": types.float64, "int": types.int32}[self.kind]

    @property
    def llvm(self) -> Any:
        return ir.VectorType(self.element, self.lanes)


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Vector) -> None:
        super().__init__(dmm, fe_type, fe_type.llvm)  # type: ignore[no-untyped-call]


def broadcast(code: Code, value: Any, vector: Vector) -> Any:
    """Emit code for a vector with a scalar in every lane, and return its LLVM value.

    code : where LLVM instructions are emitted; vector : type of the vector
    """
    one = code.builder.insert_element(ir.Constant(vector.llvm, ir.Undefined), value, INT(0))
    return shuffle(code, one, one, [0] * vector.lanes)


def shuffle(code: Code, a: Any, b: Any, lanes: Sequence[int]) -> Any:
    """Emit code for a vector of selected lanes of two vectors.

    code : where LLVM instructions are emitted; lanes : their numbers; those of b follow those of a
    """
    return code.builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(INT, len(lanes)), list(lanes)))


@lower_cast(types.Number, Vector)
def _number_to_vector(context: Any, builder: Any, fromty: Any, toty: Any, value: Any) -> Any:
    return broadcast(Code(context, builder, None), context.cast(builder, value, fromty, toty.scalar), toty)


def _binary(op: Any, kinds: tuple[str, ...], emit: Any, to_mask: bool = False) -> None:
    """Register a binary operator of kernels for two vectors, or for a vector and a number.

    op : of the module `operator`; kinds : kinds of lanes that have it; emit : emits its LLVM instruction
    to_mask : whether it is a comparison, whose result is a mask
    """

    class Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
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
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return emit(builder, sig.args[0].kind, *args)


def _arithmetic(float_op: str, int_op: str | None) -> Any:
    def emit(builder: Any, kind: str, a: Any, b: Any) -> Any:
        if kind != "int":
            return getattr(builder, float_op)(a, b, flags=FLAGS)
        return getattr(builder, str(int_op))(a, b)

    return emit


def _compare(symbol: str) -> Any:
    def emit(builder: Any, kind: str, a: Any, b: Any) -> Any:
        if kind != "int":
            return builder.fcmp_ordered(symbol, a, b)
        return builder.icmp_signed(symbol, a, b)

    return emit


NUMBERS = "float", "double", "int"
_binary(operator.add, NUMBERS, _arithmetic("fadd", "add"))
_binary(operator.sub, NUMBERS, _arithmetic("fsub", "sub"))
_binary(operator.mul, NUMBERS, _arithmetic("fmul", "mul"))
_binary(operator.truediv, ("float", "double"), _arithmetic("fdiv", None))
_ORDERS = ((operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="), (operator.ne, "!="))
for _op, _symbol in _ORDERS:
    _binary(_op, NUMBERS, _compare(_symbol), to_mask=True)
_binary(operator.and_, ("mask",), lambda builder, kind, a, b: builder.and_(a, b))
_binary(operator.or_, ("mask", "int"), lambda builder, kind, a, b: builder.or_(a, b))
_binary(operator.xor, ("mask",), lambda builder, kind, a, b: builder.xor(a, b))

F4, F8, F16 = Vector("float", 4), Vector("float", 8), Vector("float", 16)
D8 = Vector("double", 8)
I16, I8 = Vector("int", 16), Vector("int", 8)
