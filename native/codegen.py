"""Numba's compiler for a target other than this process; compiled code is never called here.

`use(system, level)` sets this process up, which must not have compiled anything before.
"""

from __future__ import annotations

import itertools
import os
from typing import Any

import llvmlite.binding as ll
import llvmlite.ir as ir

from .targets import LEVELS, SYSTEMS


def use(system: str, level: str) -> None:
    """Make Numba compile for a target from now on."""
    chosen = LEVELS[level]
    # Numba reads these when it is imported, as does `pointray.engine.simd.memory`.
    os.environ.update(NUMBA_CPU_NAME=chosen.name, NUMBA_CPU_FEATURES=chosen.features, POINTRAY_KERNELS="jit")
    ll.initialize_all_targets()
    ll.initialize_all_asmprinters()

    from numba.core import codegen, cpu
    from numba.core.callconv import CPUCallConv
    from numba.core.registry import cpu_target

    triple, addresses = SYSTEMS[system].triple, itertools.count(16, 16)

    class Library(codegen.AOTCodeLibrary):
        """The code of a function."""

        def get_pointer_to_function(self, name: str) -> int:
            """Return a number that identifies the function to Numba; it has no address here."""
            return next(addresses)

    class Codegen(codegen.CPUCodegen):
        """Code for the target, without an execution engine."""

        _library_class = Library

        def _init(self, llvm_module: Any) -> None:
            target = ll.Target.from_triple(triple)
            self._tm_features = chosen.features
            self._tm = target.create_target_machine(
                opt=3, reloc="pic", codemodel="default", cpu=chosen.name, features=chosen.features
            )
            self._target_data = self._tm.target_data
            self._data_layout = str(self._target_data)
            self._loopvect, self._opt_level = False, 0  # as in Numba

        def _create_empty_module(self, name: str) -> Any:
            module = super()._create_empty_module(name)
            module.triple = triple
            return module

        def _add_module(self, module: Any) -> None:
            """Load nothing."""

        def set_env(self, name: str, env: Any) -> None:
            """Set nothing, because nothing is called."""

    class CallConv(CPUCallConv):
        """Calling convention with errors as texts, `NameOfException: message`, because C cannot read pickles."""

        def set_static_user_exc(
            self, builder: Any, exc: Any, exc_args: Any = None, loc: Any = None, func_name: Any = None
        ) -> None:
            message = " ".join(map(str, exc_args or ()))
            text = self.context.insert_const_string(builder.module, f"{exc.__name__}: {message}")
            where = self._get_excinfo_argument(builder.function)
            builder.store(builder.bitcast(text, where.type.pointee), where)

        def set_dynamic_user_exc(self, builder: Any, exc: Any, exc_args: Any, *more: Any, **options: Any) -> None:
            """Leave out values known only at run time, because only Python could format them."""
            known = tuple("?" if isinstance(value, ir.Value) else value for value in exc_args)
            self.set_static_user_exc(builder, exc, known)

    class Context(cpu.CPUContext):
        """Numba's compilation context with both of these."""

        call_conv = property(CallConv)

        def init(self) -> None:
            self.is32bit, self._internal_codegen = False, Codegen("pointray")

    cpu_target.__dict__["_toplevel_target_context"] = Context(cpu_target.typing_context, "cpu")
