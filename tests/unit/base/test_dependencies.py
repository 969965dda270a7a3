"""Keys of compiled kernels and cached models: which files they depend on."""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import os
import pkgutil
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

import pointray
from helpers.architecture import statements
from pointray.base import dependencies
from pointray.base.dependencies import ROOT, files_of
from pointray.engine import jit
from pointray.engine.jit.decorators import Later

FILES = sorted(ROOT.rglob("*.py"))


def naive_imports(path: Path, nodes: Iterable[ast.AST]) -> set[Path]:
    """Files of the package that some nodes of a file's syntax tree import."""
    found = set()
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and (node.level or str(node.module).split(".")[0] == "pointray"):
            folder = path.parents[node.level - 1] if node.level else ROOT.parent
            base = folder.joinpath(*(node.module or "").split("."))
            modules = [base, *(base / alias.name for alias in node.names)]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names if alias.name.split(".")[0] == "pointray"]
            modules = [ROOT.parent.joinpath(*name.split(".")) for name in names]
        elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "LATER":
            modules = [path.with_name(name) for name in ast.literal_eval(node.value)]
        else:
            continue
        found |= {file for module in modules for file in (module.with_suffix(".py"), module / "__init__.py")}
    return {file for file in found if file.is_file()}


@pytest.mark.long
def test_imports_found_by_text_equal_those_of_the_syntax_tree():
    for path in FILES:
        tree = ast.parse(path.read_bytes())
        for deferred, nodes in ((False, tree.body), (True, statements(tree))):
            assert dependencies._imports(path, deferred) == naive_imports(path, nodes), path


def test_all_forms_of_imports_are_found(tmp_path):
    """In a file outside the package: comments, parentheses, several modules in a line, files next to it."""
    for name in ("one", "two", "three", "four", "seven", "eight"):
        (tmp_path / f"{name}.py").write_text("")
    (tmp_path / "room").mkdir()
    for name in ("__init__", "five", "six"):
        (tmp_path / "room" / f"{name}.py").write_text("")
    own = tmp_path / "own.py"
    own.write_text(
        "import os, one\nimport two as renamed\nfrom three import (  # not (four)\n    x,  # four\n    y as z,\n)\n"
        "from room import five\nfrom pointray.engine.kernels import vec\nimport numpy\nLATER = 'seven', 'eight'\n\n\n"
        "def f():\n    import four\n    from room.six import x\n"
    )
    here = {"own.py", "one.py", "two.py", "three.py", "room/__init__.py", "room/five.py", "seven.py", "eight.py"}
    found = set(files_of([own]))
    assert {file.relative_to(tmp_path).as_posix() for file in found if file.is_relative_to(tmp_path)} == here
    assert ROOT / "engine/kernels/vec.py" in found and ROOT / "engine/jit/compile.py" in found
    assert set(files_of([own], deferred=True)) - found == {tmp_path / "four.py", tmp_path / "room/six.py"}


def functions_of(kernel: object) -> set[object]:
    """Functions of the package that a compiled kernel calls, found by the global names in its code."""
    seen: set[object] = set()
    waiting = [kernel.py_func]
    while waiting:
        function = waiting.pop()
        if function in seen:
            continue
        seen.add(function)
        codes, names = [function.__code__], set()
        while codes:
            code = codes.pop()
            names |= set(code.co_names)
            codes += [constant for constant in code.co_consts if inspect.iscode(constant)]
        for name in names:
            value = function.__globals__.get(name)
            values = [getattr(value, more, None) for more in names] if inspect.ismodule(value) else [value]
            for one in values:
                one = one.real if isinstance(one, Later) else one
                inner = getattr(one, "py_func", getattr(one, "_defn", one))
                if inspect.isfunction(inner) and Path(inner.__code__.co_filename).is_relative_to(ROOT):
                    waiting.append(inner)
    return seen


def test_the_key_of_a_kernel_covers_every_function_that_it_calls():
    for module in pkgutil.walk_packages(pointray.__path__, "pointray."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    most = 0
    kernels = {name: kernel for name, kernel in jit.KERNELS.items() if name.startswith("pointray.")}
    assert len(kernels) > 90
    for name, kernel in kernels.items():
        files = {Path(function.__code__.co_filename) for function in functions_of(kernel)}
        assert files <= set(files_of([Path(kernel.py_func.__code__.co_filename)])), name
        most = max(most, len(files))
    assert most > 30  # the search above does find calls


KEYS = """
import json, sys
from pathlib import Path
from pointray.model import model_cache
from pointray.base import dependencies
from pointray.engine.jit.decorators import Later
from pointray.base.dependencies import ROOT, key_of

def keys():
    dependencies._text.cache_clear()
    dependencies.digest_of.cache_clear()
    model_cache.source_key.cache_clear()
    found = {name: key_of([ROOT / name]) for name in sys.argv[1].split()}
    return {**found, "model": model_cache.source_key()}

before, changed = keys(), {}
for name in sys.argv[2].split():
    path = ROOT / name
    text = path.read_bytes()
    path.write_bytes(text + b"# edited\\n")
    changed[name] = [key for key, value in keys().items() if value != before[key]]
    path.write_bytes(text)
assert keys() == before
print(json.dumps(changed))
"""
KERNELS = [
    "cloud/neighbors/search.py",
    "surface/tree/leaves.py",
    "surface/trace/cast.py",
    "rendering/integrate.py",
    "baking/gather.py",
]
SEARCH, LEAVES, CAST, FRAME, RAYS = KERNELS
CHANGED = {  # file -> keys that its edit changes
    "__main__.py": [],
    "base/arguments.py": [FRAME, RAYS, "model"],
    "baking/gather.py": [RAYS],
    "cli/options.py": [],
    "cluster/client.py": [],
    "compat/tensors.py": [],
    "image/tone.py": [],
    "surface/intersect/march.py": [CAST, FRAME, RAYS],
    "engine/jit/compile.py": [*KERNELS, "model"],
    "engine/kernels/vec.py": [LEAVES, CAST, FRAME, RAYS, "model"],
    "cloud/neighbors/search.py": [SEARCH, "model"],
    "cloud/neighbors/tree.py": ["model"],
    "model/out_of_core/levels.py": [],
    "io/formats/ply/ply.py": ["model"],
    "cloud/denoising/fit.py": ["model"],
    "procedural_models/clay.py": [],
    "rendering/picture.py": [],
    "rendering/film.py": [FRAME],
    "scene/scene.py": [],
    "scenefile/words.py": [],
    "shade/path.py": [FRAME],
    "engine/simd/vector.py": [*KERNELS, "model"],
    "surface/splats/voronoi.py": ["model"],
    "auto_view/studio.py": [],
    "surface/trace/traverse.py": [CAST, FRAME, RAYS],
    "surface/tree/cells.py": [LEAVES, "model"],
    "viewer/viewer.py": [],
}


def test_an_edit_changes_the_keys_that_depend_on_it_and_no_others(tmp_path):
    """One file of each folder, and an edit of the neighbour search, which once did not invalidate cached models."""
    folders = {path.relative_to(ROOT).parts[0] for path in FILES if path.parent != ROOT}
    assert folders <= {Path(name).parts[0] for name in CHANGED}
    shutil.copytree(ROOT, tmp_path / "pointray", ignore=shutil.ignore_patterns("__pycache__"))
    command = [sys.executable, "-c", KEYS, " ".join(KERNELS), " ".join(CHANGED)]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == CHANGED
