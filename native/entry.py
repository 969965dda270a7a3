"""The C function of a kernel: `int32_t pr_NAME(const int64_t *slots, int64_t *out)`.

slots : the leaves of the arguments, eight bytes each; an array is passed as address, shape and, if its layout permits
any, strides. out : the leaves of the result; an array is returned as address, owner, shape. If the function does not
return 0, out[0] is the address of the error's text.
"""

from __future__ import annotations

from typing import Any

import llvmlite.ir as ir
from numba.core import cgutils, types

I64 = ir.IntType(64)


def add_entry(context: Any, library: Any, description: Any, name: str) -> None:
    """Add the C function of a kernel to the library of its code.

    description : Numba's function descriptor of the compiled kernel
    """
    module = context.codegen()._create_empty_module(name)
    words = I64.as_pointer()
    function = ir.Function(module, ir.FunctionType(ir.IntType(32), [words, words]), name)
    builder = ir.IRBuilder(function.append_basic_block("entry"))
    convention = context.call_conv
    callee = ir.Function(
        module, convention.get_function_type(description.restype, description.argtypes), description.llvm_func_name
    )
    reader = _Reader(context, builder, function.args[0])
    arguments = [reader.read(kind) for kind in description.argtypes]
    status, result = convention.call_function(
        builder, callee, description.restype, description.argtypes, arguments, attrs=("noinline",)
    )
    with builder.if_then(status.is_error, likely=False):
        builder.store(builder.ptrtoint(status.excinfoptr, I64), function.args[1])
        builder.ret(status.code)
    _Writer(context, builder, function.args[1]).write(description.restype, result)
    builder.ret(ir.Constant(ir.IntType(32), 0))
    library.add_ir_module(module)


class _Reader:
    """Reader of values from consecutive slots."""

    def __init__(self, context: Any, builder: Any, slots: Any) -> None:
        self._context, self._builder, self._slots, self._next = context, builder, slots, 0

    def read(self, kind: Any) -> Any:
        """Read the next value, of a Numba type."""
        if isinstance(kind, types.Array):
            return self._read_array(kind)
        if isinstance(kind, types.BaseTuple):
            return self._context.make_tuple(self._builder, kind, [self.read(item) for item in kind])
        word = self._word()
        if kind in types.integer_domain:
            return word if kind.bitwidth == 64 else self._builder.trunc(word, ir.IntType(kind.bitwidth))
        if kind == types.float64:
            return self._builder.bitcast(word, ir.DoubleType())
        if kind == types.float32:
            return self._builder.bitcast(self._builder.trunc(word, ir.IntType(32)), ir.FloatType())
        if kind == types.boolean:
            return self._builder.trunc(word, ir.IntType(1))
        raise NotImplementedError(f"unsupported type of a kernel argument: {kind}")

    def _word(self) -> Any:
        where = self._builder.gep(self._slots, [ir.Constant(ir.IntType(32), self._next)])
        self._next += 1
        return self._builder.load(where)

    def _read_array(self, kind: Any) -> Any:
        """Read an array whose memory is kept by its owner."""
        context, builder = self._context, self._builder
        item = context.get_abi_sizeof(context.get_data_type(kind.dtype))
        array, address = context.make_array(kind)(context, builder), self._word()
        shape = [self._word() for _ in range(kind.ndim)]
        strides = [self._word() for _ in range(kind.ndim)] if kind.layout == "A" else self._strides(kind, shape, item)
        context.populate_array(
            array,
            data=builder.inttoptr(address, array.data.type),
            shape=cgutils.pack_array(builder, shape),
            strides=cgutils.pack_array(builder, strides),
            itemsize=ir.Constant(I64, item),
            meminfo=None,
        )
        return array._getvalue()

    def _strides(self, kind: Any, shape: list[Any], item: int) -> list[Any]:
        """Return the strides of a contiguous array."""
        order = range(kind.ndim) if kind.layout == "F" else range(kind.ndim - 1, -1, -1)
        strides, step = [None] * kind.ndim, ir.Constant(I64, item)
        for axis in order:
            strides[axis], step = step, self._builder.mul(step, shape[axis])
        return strides


class _Writer:
    """Writer of values into consecutive words."""

    def __init__(self, context: Any, builder: Any, out: Any) -> None:
        self._context, self._builder, self._out, self._next = context, builder, out, 0

    def write(self, kind: Any, value: Any) -> None:
        """Write a value of a Numba type."""
        builder, kind = self._builder, types.unliteral(kind)
        if kind == types.none:
            return
        if isinstance(kind, types.BaseTuple):
            for k, item in enumerate(kind):
                self.write(item, builder.extract_value(value, k))
        elif isinstance(kind, types.Array):
            array = self._context.make_array(kind)(self._context, builder, value)
            shape = cgutils.unpack_tuple(builder, array.shape, kind.ndim)
            for word in (builder.ptrtoint(array.data, I64), builder.ptrtoint(array.meminfo, I64), *shape):
                self._put(word)
        elif kind == types.float64:
            self._put(builder.bitcast(value, I64))
        elif kind == types.boolean:
            self._put(builder.zext(value, I64))
        elif kind in types.integer_domain:
            extend = builder.sext if kind.signed else builder.zext
            self._put(value if kind.bitwidth == 64 else extend(value, I64))
        else:
            raise NotImplementedError(f"unsupported type of a kernel result: {kind}")

    def _put(self, word: Any) -> None:
        self._builder.store(word, self._builder.gep(self._out, [ir.Constant(ir.IntType(32), self._next)]))
        self._next += 1
