"""Count the rooms of the package, the imports between them, files and functions.

python -m bench.maintenance.house [FOLDER]

A room is a folder of the package or a file at its top. An arrow is an import of one room by another. The lines of a
function include its docstring.
"""

from __future__ import annotations

import argparse
import ast
import statistics
from pathlib import Path


def arrows(package: Path) -> set[tuple[str, str]]:
    """Pairs of rooms, the first importing from the second."""
    found = set()
    for path in package.rglob("*.py"):
        folder = path.relative_to(package).parts[:-1]
        room = (*folder, path.stem)[0]
        for node in ast.walk(ast.parse(path.read_text())):
            if room != "__init__" and isinstance(node, ast.ImportFrom) and node.level == len(folder) + 1:
                names = [node.module] if node.module else [alias.name for alias in node.names]
                found |= {(room, name.split(".")[0]) for name in names if not name.startswith("__")}
    return {(room, other) for room, other in found if room != other}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "folder", nargs="?", type=Path, default=Path(__file__).resolve().parents[2] / "src" / "pointray"
    )
    package = parser.parse_args().folder
    files = {path.relative_to(package).as_posix(): path.read_text() for path in package.rglob("*.py")}
    lines = {name: len(text.splitlines()) for name, text in files.items()}
    functions = {
        f"{name}:{node.name}": (node.end_lineno or 0) - node.lineno + 1
        for name, text in files.items()
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    }
    rooms = {name.split("/")[0].removesuffix(".py") for name in files} - {"__init__"}
    print(f"{len(rooms)} rooms, {len(arrows(package))} arrows, {len(files)} files, {len(functions)} functions")
    for kind, sizes in (("file", lines), ("function", functions)):
        longest = max(sizes, key=sizes.__getitem__)
        print(f"lines of a {kind}: median {statistics.median(sizes.values()):g}, longest {sizes[longest]} ({longest})")
    ignored = sum(text.count("type: ignore[no-untyped-def]") for text in files.values())
    print(f"functions without annotations: {ignored}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
