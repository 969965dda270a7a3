"""The order of rooms, and the imports that the package has."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pointray

PACKAGE = Path(pointray.__file__).parent

# From the ground up: a room imports only from rooms before it and from itself. A room is a folder.
TOWER = [
    *("base", "engine", "cloud", "io", "procedural_models", "surface", "model"),
    *("shade", "image", "scene", "baking", "rendering", "cluster"),
    *("auto_view", "compat", "scenefile", "viewer", "cli", "__main__"),
]

# The same inside of large rooms, for the folders and files that are named here.
FLOORS = {
    "engine": ["jit", "simd", "kernels"],
    "cloud": [
        *(
            "georeference",
            "shifting",
            "convertible",
            "points",
            "conversion",
            "geographic",
            "statistics",
            "sampled_statistics",
            "neighbors",
            "kd_ordering",
        ),
        *("rounding", "normals", "outliers", "denoising", "cleaning", "preparation"),
    ],
    "io": [
        "remote",
        "formats",
        "unpacking",
        "plugins",
        "known_formats",
        "inputs",
        "selection",
        "opening",
        "gather",
        "spooling",
        "files",
        "previews",
        "exchange",
        "trajectory",
    ],
    "surface": ["tree", "splats", "intersect", "trace"],
    "model": [
        *("array_file", "model_file", "model_data", "model_folder", "building", "levels_of_detail", "residency"),
        *("traceable", "model", "model_cache", "out_of_core", "scan_inputs", "preparation_options", "preparation"),
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
