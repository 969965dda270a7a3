"""The order of imports: which room may import which, who may import Numba, and no circles."""

import ast
import graphlib
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pointray

PACKAGE = Path(pointray.__file__).parent

# From the ground up: a room imports only from rooms before it and from itself. A room is a folder, or a file at the
# top.
TOWER = [
    *(
        "dependencies",
        "jit",
        "simd",
        "arguments",
        "choices",
        "extras",
        "progress",
        "notes",
        "memory",
        "kernels",
        "survey",
        "data",
    ),
    *(
        "neighbors",
        "points",
        "tree",
        "splats",
        "intersect",
        "trace",
        "array_file",
        "model_file",
        "model_folder",
        "residence",
        "model",
        "model_cache",
    ),
    *("shade", "image", "cluster", "parts", "scene", "baking", "rendering", "staging"),
    *("scenefile", "viewer", "cli", "__main__"),
]


def name_of(path: Path) -> str:
    """The name of a file's module below the package, such as `surface.trace.tile`; an `__init__` has that of its folder."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {name_of(path): path for path in PACKAGE.rglob("*.py")}


def statements(tree: ast.AST) -> Iterator[ast.AST]:
    """All statements below a node; a walk over all nodes takes ten times as long."""
    for name in ("body", "orelse", "finalbody", "handlers", "cases"):
        for node in getattr(tree, name, ()):
            yield node
            yield from statements(node)


def imports(path: Path) -> set[str]:
    """All imports of a file, even in functions: the package's modules as in `FILES`, others with full names."""
    folder = path.parent.relative_to(PACKAGE.parent).parts
    named = []
    for node in statements(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            named += [alias.name for alias in node.names]
        if isinstance(node, ast.ImportFrom):
            base = folder[: len(folder) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            named += [f"{module}.{alias.name}" if _inner(f"{module}.{alias.name}") else module for alias in node.names]
    return {_inner(name) or name for name in named}


def _inner(module: str) -> str:
    """The name in `FILES` of a module of the package, or an empty string."""
    name = module.removeprefix("pointray.")
    return name if module.startswith("pointray.") and name in FILES else ""


def upwards(tower: list[str], imported: dict[str, set[str]]) -> list[tuple[str, str]]:
    """Imports that point up in a tower."""
    floor = {room: k for k, room in enumerate(tower)}
    rooms = {(name, other): (name.split(".")[0], other.split(".")[0]) for name in imported for other in imported[name]}
    return [pair for pair, (room, other) in rooms.items() if other in floor and floor[other] > floor[room]]


@cache
def arrows() -> dict[str, set[str]]:
    """What each file imports; the package's own `__init__` imports all names."""
    return {name: imports(path) for name, path in FILES.items() if name}


def test_every_room_has_its_floor():
    assert {name.split(".")[0] for name in arrows()} <= set(TOWER)


def test_every_import_points_down():
    assert upwards(TOWER, arrows()) == []
    assert upwards(["points", "cli"], {"io.files": {"cli.view", "os"}}) == [("io.files", "cli.view")]


def test_no_files_import_each_other_in_a_circle():
    graphlib.TopologicalSorter({name: others & FILES.keys() for name, others in arrows().items()}).prepare()


def test_only_the_engine_imports_numba():
    users = {name for name, others in arrows().items() if {o.split(".")[0] for o in others} & {"numba", "llvmlite"}}
    assert {name.split(".")[0] for name in users} == {"jit", "simd"}


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, pointray; print([m for m in ('numba', 'scipy', 'PIL') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_is_there():
    for name in pointray.__all__:
        assert getattr(pointray, name) is not None
    assert callable(pointray.render)
