"""Build pointray's kernels as native libraries: `python -m native` in the project's root folder.

Without arguments, it builds for this processor and into the package, where tests and commands find the library. After
an edit only the changed kernels are compiled. `python -m native signatures` records the argument types of all kernels
after they have changed.
"""

from __future__ import annotations

import argparse
import platform
from pathlib import Path

from . import signatures
from .library import make
from .link import compiler, zig
from .objects import Order
from .targets import LEVELS, SYSTEMS

ROOT = Path(__file__).parents[1]
LIBRARIES = ROOT / "src/pointray/engine/native"


def this_system() -> str:
    """Return the name of this system in `SYSTEMS`, if it is there."""
    return f"{platform.system().lower()}-{platform.machine().lower()}"


def show(done: int, total: int, kernel: str) -> None:
    """Print which kernel is done."""
    print(f"{done}/{total} {kernel.removeprefix('pointray.')}", flush=True)


def best_level(system: str) -> str | None:
    """Return the best level of this machine's processor; None if it does not reach the lowest."""
    from llvmlite.binding import get_host_cpu_features

    features = get_host_cpu_features()
    fitting = [level for level in SYSTEMS[system].levels if _has(features, LEVELS[level].features)]
    return fitting[-1] if fitting else None


def _has(features: dict[str, bool], wanted: str) -> bool:
    return all(features.get(name.removeprefix("+"), True) for name in wanted.split(","))


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m native", description=__doc__)
    parser.add_argument("what", nargs="?", choices=["build", "signatures"], default="build")
    parser.add_argument("--system", choices=SYSTEMS, default=this_system())
    parser.add_argument("--level", action="append", help="processor level; best: this one's (default; with --zig all)")
    parser.add_argument("--zig", action="store_true", help="link with Zig, for older or other systems")
    parser.add_argument("--out", type=Path, default=LIBRARIES)
    parser.add_argument("--objects", type=Path, default=ROOT / "build/native", help="folder of object files")
    parser.add_argument("--jobs", type=int, help="number of processes (default: one for each core)")
    arguments = parser.parse_args()
    signatures.import_all()
    if arguments.what == "signatures":
        signatures.record()
        return
    if arguments.system not in SYSTEMS:
        print(f"{arguments.system}: not a target in native/targets.py; Numba compiles kernels instead")
        return
    command = zig(arguments.system) if arguments.zig else compiler()
    wanted = arguments.level or (SYSTEMS[arguments.system].levels if arguments.zig else ["best"])
    levels = tuple(dict.fromkeys(best_level(arguments.system) if level == "best" else level for level in wanted))
    if command is None or None in levels:
        print("no C compiler (cc) found, or processor below the lowest level: Numba compiles kernels instead")
        return
    make(Order(arguments.system, levels, arguments.objects, arguments.jobs), arguments.out, command, show)


if __name__ == "__main__":
    main()
