"""Compilation of a kernel to an object file, in a process that `codegen.use` has set up."""

from __future__ import annotations

from typing import Any

import llvmlite.binding as ll

from pointray.engine.jit import KERNELS
from pointray.engine.jit.library import symbol

from . import signatures
from .entry import add_entry


def compiled(kernel: str) -> tuple[bytes, Any]:
    """Return the object file of a kernel, and its result type as text."""
    module, machine, returns = _optimized(kernel)
    return bytes(machine.emit_object(module)), returns


def assembly(kernel: str) -> str:
    """Return the machine code of a kernel as text."""
    module, machine, _ = _optimized(kernel)
    return str(machine.emit_assembly(module))


def _optimized(kernel: str) -> tuple[Any, Any, Any]:
    """Return the LLVM module of a kernel, LLVM's target machine, and the kernel's result type as text."""
    recorded = signatures.recorded()
    types = tuple(signatures.type_of(text, recorded["records"]) for text in recorded["kernels"][kernel])
    compiler = KERNELS[kernel].dispatcher._compiler

    def customize(flags: Any) -> Any:
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        return flags

    compiler._customize_flags = customize
    passed, result = compiler._compile_cached(types, None)
    if not passed:
        raise result
    library, name = result.library, symbol(kernel)
    add_entry(result.target_context, library, result.fndesc, name)
    records: dict[str, Any] = {}
    _link(library, name)
    returns = signatures.described(result.signature.return_type, records)
    return library._final_module, library.codegen._tm, returns


def _link(library: Any, entry: str) -> None:
    """Link a kernel with its pieces, optimize it, and remove code that its entry does not reach."""
    for piece in dict.fromkeys(library._linking_libraries):
        library._final_module.link_in(piece._get_module_for_linking(), preserve=True)
    library._optimize_final_module()
    module = library._final_module
    for one in (*module.functions, *module.global_variables):
        if not one.is_declaration and one.name != entry:
            one.linkage = ll.Linkage.internal
    builder = ll.create_pass_builder(library.codegen._tm, ll.create_pipeline_tuning_options(speed_level=0))
    passes = ll.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(module, builder)
    module.verify()
