"""Make docs/formats.md from what the readers say of themselves.

python -m bench.maintenance.formats_table
"""

from __future__ import annotations

from pathlib import Path

import pointray as pr

TARGET = Path(__file__).resolve().parents[2] / "docs" / "formats.md"
COLUMNS = {
    "positions": "positions",
    "normals": "normals",
    "colors": "colours",
    "attributes": "attributes",
    "survey": "coordinate system, unit, scanners",
}
HEAD = """# File formats

<!-- Made by `python -m bench.maintenance.formats_table` from what the readers say; test_formats_table.py compares. -->

What a file is its contents tell, not its name. `.gz` and `.zst` are unpacked first. Several files are one cloud, and a
folder stands for the scans in it; they must not have different coordinate systems. `pointray convert IN... OUT` writes
the formats marked so, and tells what the target cannot hold. A saved model, `.pointray`, is what `pointray prepare`
makes of any of them. `pr.formats()` has the same table.

A file that is cut off, or holds other rows than its header announces, is read as far as it goes, and a warning says how
many rows are missing; `--strict`, in Python `pr.read(..., strict=True)`, refuses it. Without what is missing no point
is found in LAZ, COPC, E57, NPZ, SPZ, glTF, depth pictures and packed PCD files that are cut off: they are refused, and
so is a file without a point.
"""


def row(*cells: str) -> str:
    """A row of a table."""
    return f"| {' | '.join(cell.replace('|', '/') or ' ' for cell in cells)} |"


def formats_page() -> str:
    """The document."""
    formats = pr.formats()
    lines = [HEAD, row("format", "files", "written", "needs"), row(*["---"] * 4)]
    for x in formats:
        needs = f"`pip install 'pointray[{x.extra}]'`" if x.extra else ""
        lines.append(row(x.name, " ".join(f"`{e}`" for e in x.extensions), "yes" if x.writes else "", needs))
    lines += ["", "## What is kept", "", row("format", *COLUMNS.values()), row(*["---"] * (len(COLUMNS) + 1))]
    lines += [row(x.name, *(x.keeps.get(name, "") for name in COLUMNS)) for x in formats]
    notes = [f"- **{x.name}:** {x.keeps['note']}" for x in formats if x.keeps.get("note")]
    return "\n".join([*lines, *(["", "## Notes", "", *notes] if notes else [])]) + "\n"


if __name__ == "__main__":
    TARGET.write_text(formats_page())
    print(f"{TARGET}: {len(pr.formats())} formats")
