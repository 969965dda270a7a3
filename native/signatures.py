"""The argument types of each kernel as text, recorded from kernels that Numba has compiled.

A number is `i8`, `f4`, `b1` and so on; an array `f4[2C]`, with its number of axes and its layout (C, F, or A for any),
`const f4[2C]` if it is read-only; a tuple is a list; a named tuple is `package.module:Class`, see `records`.
"""

from __future__ import annotations

import importlib
import json
import pkgutil
from pathlib import Path
from typing import Any

import pointray
from pointray.engine.jit import KERNELS

FILE = Path(__file__).with_name("signatures.json")


def import_all() -> None:
    """Import all modules of the package, which registers all kernels."""
    for module in pkgutil.walk_packages(pointray.__path__, "pointray."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)


def shipped() -> list[str]:
    """Return the kernels of the package."""
    return sorted(name for name in KERNELS if name.startswith("pointray."))


def known() -> list[str]:
    """Return the kernels whose arguments are recorded; Numba compiles the others when they are first called."""
    return [name for name in shipped() if name in recorded()["kernels"]]


def compiled_types(name: str) -> tuple[Any, ...] | None:
    """Return Numba's types of a kernel's arguments, from the only compiled version in this process or on disk."""
    dispatcher = KERNELS[name].dispatcher
    found = {tuple(signature) for signature in dispatcher.signatures}
    if not found:
        found = {tuple(key[0]) for key in dispatcher._cache._cache_file._load_index()}
    if len(found) > 1:
        raise ValueError(f"{name} is compiled for several argument types: {sorted(map(str, found))}")
    return found.pop() if found else None


def described(kind: Any, records: dict[str, Any]) -> Any:
    """Return a Numba type as text; add named tuples to `records`."""
    from numba.core import types
    from numba.np.numpy_support import as_dtype

    kind = types.unliteral(kind)
    if kind == types.none:
        return "none"
    if isinstance(kind, types.Array):
        text = f"{as_dtype(kind.dtype).str[1:]}[{kind.ndim}{kind.layout}]"
        return text if kind.mutable else f"const {text}"
    if isinstance(kind, types.BaseNamedTuple):
        home = kind.instance_class
        name, fields = f"{home.__module__}:{home.__qualname__}", [described(item, records) for item in kind]
        if records.setdefault(name, fields) != fields:
            raise ValueError(f"{name} has different field types in different kernels: {fields}, {records[name]}")
        return name
    if isinstance(kind, types.BaseTuple):
        return [described(item, records) for item in kind]
    return as_dtype(kind).str[1:]


def type_of(text: Any, records: dict[str, Any]) -> Any:
    """Return the Numba type of a text."""
    import numpy as np
    from numba.core import types
    from numba.np.numpy_support import from_dtype

    if isinstance(text, list):
        return types.BaseTuple.from_types([type_of(item, records) for item in text])
    if ":" in text:
        module, name = text.split(":")
        home = getattr(importlib.import_module(module), name)
        return types.BaseTuple.from_types([type_of(item, records) for item in records[text]], home)
    item, bracket, shape = text.removeprefix("const ").partition("[")
    dtype = from_dtype(np.dtype(item))
    if not bracket:
        return dtype
    return types.Array(dtype, int(shape[:-2]), shape[-2], readonly=text.startswith("const "))


def record() -> None:
    """Write the file anew."""
    import_all()
    found = {name: compiled_types(name) for name in shipped()}
    missing = [name for name, kinds in found.items() if kinds is None]
    if missing:
        raise SystemExit(f"not compiled yet, so run the tests first: {', '.join(missing)}")
    records: dict[str, Any] = {}
    kernels = {name: [described(kind, records) for kind in kinds or ()] for name, kinds in found.items()}
    FILE.write_text(f'{{"records": {_lines(dict(sorted(records.items())))},\n"kernels": {_lines(kernels)}}}\n')


def _lines(rows: dict[str, Any]) -> str:
    """Return JSON with one row on each line, so that diffs are readable."""
    return "{\n" + ",\n".join(f" {json.dumps(name)}: {json.dumps(row)}" for name, row in rows.items()) + "\n}"


def recorded() -> dict[str, Any]:
    """Return the contents of the file."""
    found: dict[str, Any] = json.loads(FILE.read_text())
    return found
