"""Count the stack accesses in the loops of the tracing kernel, for each processor level.

    python -m bench.maintenance.stack [--level x86-64-v2 ...] [--rows 8]

A processor has 16 (x86-64-v2 and v3) or 32 vector registers (v4, NEON). Loops with more vectors keep some in memory,
on the stack. The program compiles `cast._closest`, which traces the closest hits of rays, and prints its innermost
loops with the most arithmetic on float32 vectors, such as the sums over splats from which f is computed. The last
column compares loops of different lengths: stack accesses for each hundred arithmetic instructions.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from typing import NamedTuple

from native.targets import SYSTEMS

KERNEL = "pointray.surface.trace.cast._closest"
SYSTEM_OF = {level: system for system in ("linux-aarch64", "linux-x86_64") for level in SYSTEMS[system].levels}
ASSEMBLY = """
import sys
from native import codegen, signatures
codegen.use(sys.argv[1], sys.argv[2])
signatures.import_all()
from native.emit import assembly
print(assembly(sys.argv[3]))
"""
LANES = {"xmm": 4, "ymm": 8, "zmm": 16, "v": 4}
STACK = re.compile(r"\((%rsp|%rbp)|\[sp|\[x29")
VECTOR = re.compile(r"%([xyz]mm)\d|\b(v)\d+\.4s")
ARITHMETIC = re.compile(r"v?(add|sub|mul|div|min|max|fn?m(add|sub)\d*)ps$|f(add|sub|mul|mla|mls|div|minnm|maxnm)$")


class Loop(NamedTuple):
    """An innermost loop. instructions, arithmetic, stack : counts; lanes : of its vectors"""

    instructions: int
    arithmetic: int
    stack: int
    lanes: int


def assembly_of(level: str) -> str:
    """Compile the kernel for a level, in a process of its own; return its assembly."""
    command = [sys.executable, "-c", ASSEMBLY, SYSTEM_OF[level], level, KERNEL]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def innermost_loops(assembly: str) -> list[Loop]:
    """Find the innermost loops of a program: the code from a label to a jump back to it, without another such jump."""
    lines: list[tuple[str, str]] = []
    places: dict[str, int] = {}
    loops: list[tuple[int, int]] = []
    for line in assembly.splitlines():
        text = line.split("#")[0].split("//")[0].strip()
        if label := re.match(r"(\.L\w+):", text):
            places[label[1]] = len(lines)
        elif text and not text.startswith(".") and not text.endswith(":"):
            name, _, operands = text.partition("\t")
            lines.append((name, operands))
            if (target := re.search(r"(\.L\w+)$", operands)) and target[1] in places and re.match("j|b|cb|tb", name):
                loops.append((places[target[1]], len(lines)))
    inner = [loop for loop in loops if not any(loop[0] <= a and b <= loop[1] and (a, b) != loop for a, b in loops)]
    return [_counted(lines[begin:end]) for begin, end in inner]


def _counted(lines: list[tuple[str, str]]) -> Loop:
    """Count what a loop contains."""
    arithmetic = [operands for name, operands in lines if ARITHMETIC.match(name)]
    kinds = [next(filter(None, found.groups())) for text in arithmetic if (found := VECTOR.search(text))]
    stack = sum(bool(STACK.search(operands)) for _, operands in lines)
    return Loop(len(lines), len(kinds), stack, max((LANES[kind] for kind in kinds), default=1))


def report(level: str, rows: int) -> None:
    """Print the loops of a level with the most arithmetic."""
    found = [loop for loop in innermost_loops(assembly_of(level)) if loop.arithmetic]
    loops = sorted(found, key=lambda loop: -loop.arithmetic * loop.lanes)[:rows]
    print(f"{level}\n  instructions  arithmetic  lanes  stack accesses  per 100")
    for loop in loops:
        share = 100 * loop.stack / loop.arithmetic
        print(f"{loop.instructions:14d}{loop.arithmetic:12d}{loop.lanes:7d}{loop.stack:16d}{share:9.0f}")
    print(flush=True)


def main() -> None:
    """Print the loops of all levels."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--level", nargs="+", choices=SYSTEM_OF, default=list(SYSTEM_OF))
    parser.add_argument("--rows", type=int, default=8, help="loops per level")
    options = parser.parse_args()
    for level in options.level:
        report(level, options.rows)


if __name__ == "__main__":
    main()
