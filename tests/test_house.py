"""The order of imports: which room may import which, who may import Numba, and no circles."""

import ast
import graphlib
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import pointray

PACKAGE = Path(pointray.__file__).parent

# From the ground up: a room imports only from rooms before it and from itself. A room is a folder.
TOWER = [
    *("base", "engine", "cloud", "io", "procedural_models", "surface", "model"),
    *("shade", "image", "scene", "baking", "rendering", "cluster"),
    *("auto_view", "scenefile", "viewer", "cli", "__main__"),
]

# The same inside of large rooms, for the folders and files that are named here.
FLOORS = {
    "engine": ["jit", "simd", "kernels"],
    "cloud": [
        *("georeference", "points", "geographic", "statistics", "sampled_statistics", "neighbors", "kd_ordering"),
        *("rounding", "normals", "outliers", "denoising", "cleaning", "preparation"),
    ],
    "io": [
        "formats",
        "unpacking",
        "known_formats",
        "selection",
        "opening",
        "gather",
        "spooling",
        "files",
        "trajectory",
    ],
    "surface": ["tree", "splats", "intersect", "trace"],
    "model": [
        *("array_file", "model_file", "model_data", "model_folder", "building", "levels_of_detail", "residency"),
        *("traceable", "model", "model_cache", "out_of_core"),
    ],
}


def name_of(path: Path) -> str:
    """The name of a file's module below the package, like `surface.trace.tile`; an `__init__` has its folder's."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {name_of(path): path for path in PACKAGE.rglob("*.py")}


def statements(tree: ast.AST) -> Iterator[ast.AST]:
    """All statements below a node; a walk over all nodes takes ten times as long."""
    for name in ("body", "orelse", "finalbody", "handlers", "cases"):
        for node in getattr(tree, name, ()):
            yield node
            yield from statements(node)


def named_in(path: Path) -> set[str]:
    """The full names of all modules that a file imports, even in functions."""
    folder = path.parent.relative_to(PACKAGE.parent).parts
    named = []
    for node in statements(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            named += [alias.name for alias in node.names]
        if isinstance(node, ast.ImportFrom):
            base = folder[: len(folder) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            named += [f"{module}.{alias.name}" if _inner(f"{module}.{alias.name}") else module for alias in node.names]
    return set(named)


def _inner(module: str) -> str:
    """The name in `FILES` of a module of the package, or an empty string."""
    name = module.removeprefix("pointray.")
    return name if module.startswith("pointray.") and name in FILES else ""


def within(room: str, imported: dict[str, set[str]]) -> dict[str, set[str]]:
    """The imports inside of a room, by names below it."""
    prefix = f"{room}."
    below = {name: others for name, others in imported.items() if name.startswith(prefix)}
    return {
        name.removeprefix(prefix): {other.removeprefix(prefix) for other in others if other.startswith(prefix)}
        for name, others in below.items()
    }


def upwards(tower: list[str], imported: dict[str, set[str]]) -> list[tuple[str, str]]:
    """Imports that point up in a tower."""
    floor = {room: k for k, room in enumerate(tower)}
    rooms = {(name, other): (name.split(".")[0], other.split(".")[0]) for name in imported for other in imported[name]}
    known = {pair: both for pair, both in rooms.items() if {*both} <= floor.keys()}
    return [pair for pair, (room, other) in known.items() if floor[other] > floor[room]]


@cache
def arrows() -> dict[str, set[str]]:
    """The modules of the package that each file imports; the package's own `__init__` imports all names."""
    return {name: {_inner(one) for one in named_in(path)} - {""} for name, path in FILES.items() if name}


def users_of(*packages: str) -> set[str]:
    """The files that import other packages."""
    return {name for name, path in FILES.items() if {one.split(".")[0] for one in named_in(path)} & {*packages}}


def test_every_room_has_its_floor():
    assert {name.split(".")[0] for name in arrows()} <= set(TOWER)


def test_every_import_points_down():
    assert upwards(TOWER, arrows()) == []
    assert upwards(["io", "cli"], {"io.files": {"cli.view", "os"}}) == [("io.files", "cli.view")]


@pytest.mark.parametrize("room", FLOORS)
def test_imports_inside_of_a_room_point_down(room):
    inside = within(room, arrows())
    assert {*FLOORS[room]} <= {name.split(".")[0] for name in inside}
    assert upwards(FLOORS[room], inside) == []


def test_the_package_has_few_entries():
    entries = {path.name for path in PACKAGE.iterdir()} - {"__init__.py", "__main__.py", "__pycache__", "py.typed"}
    assert entries == {*TOWER} - {"__main__"} and len(entries) <= 18


def test_no_files_import_each_other_in_a_circle():
    graphlib.TopologicalSorter({name: others & FILES.keys() for name, others in arrows().items()}).prepare()


def test_only_the_engine_imports_numba():
    users = users_of("numba", "llvmlite")
    assert {".".join(name.split(".")[:2]) for name in users} == {"engine.jit", "engine.simd"}


def test_only_the_cluster_and_what_stands_above_it_import_it():
    users = {name.split(".")[0] for name, others in arrows().items() if any(o.startswith("cluster.") for o in others)}
    assert users <= {"cluster", "viewer", "cli"}
    assert {name.split(".")[0] for name in users_of("dask", "distributed")} == {"cluster"}


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, pointray; print([m for m in ('numba', 'scipy', 'PIL') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_is_there():
    for name in pointray.__all__:
        assert getattr(pointray, name) is not None
    assert callable(pointray.render)
