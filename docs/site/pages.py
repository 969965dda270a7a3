"""The code, pictures and scans of a page of the documentation.

Blocks of `sh`, `python` and `toml` are run in order, in one folder for each page; the Python blocks of a page share
their variables. A `text` block directly after another block is its expected output. Images in `pictures/` are produced
by the blocks: `pictures/guides/rays/depth.webp` by the block of `guides/rays.md` that writes `depth.png`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Any

import yaml

DOCS = Path(__file__).resolve().parents[1]
ROOT = DOCS.parent
DEFAULT = {"scan.ply": "statue"}  # scans of pages that name none
LANGUAGES = "sh", "python", "toml"
BLOCK = re.compile(r"^( *)```(\w+)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)
IMAGE = re.compile(
    r"!\[[^\]]*\]\(([^)\s]*pictures/[^)\s]+)\)|^(?:`{3,}|:{3,}) *\{\w+\} (\S*pictures/\S+)", re.MULTILINE
)
HEADER = re.compile(r"\A---\n(.*?)^---\n", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Block:
    """A block of code: its language, text, and line in the page; `output` is what it prints, None if not shown."""

    language: str
    text: str
    line: int
    output: str | None = None


@dataclass(frozen=True)
class Page:
    """A page.

    scans : names of scans (of `scans.toml`) by the file names that the page uses
    quick : options of commands of the page by the values used in a build, where the stored pictures take too long;
        that of `--size` is the width, the aspect ratio remains; `python`: arguments appended to programs
    varies : whether its pictures depend on chance, as where another library returns points in a random order
    pictures : stored pictures, as paths below `docs/`
    run : whether its code is run and its pictures are compared
    """

    name: str
    path: Path
    blocks: list[Block]
    pictures: list[Path]
    scans: dict[str, str] = field(default_factory=dict)
    quick: dict[str, Any] = field(default_factory=dict)
    varies: bool = False
    run: bool = True


def load_page(path: Path) -> Page:
    """Read a page of `docs/`, or the README."""
    text = path.read_text()
    header: dict[str, Any] = yaml.safe_load(found[1]) if (found := HEADER.match(text)) else {}
    name = path.relative_to(DOCS if DOCS in path.parents else ROOT).with_suffix("").as_posix()
    links = [next(group for group in match.groups() if group) for match in IMAGE.finditer(text)]
    pictures = [(path.parent / link).resolve() for link in dict.fromkeys(links)]
    return Page(name, path, blocks_of(text), pictures, **{"scans": DEFAULT, **header})


def blocks_of(text: str) -> list[Block]:
    """Return the blocks of code of a page, each with the output that follows it."""
    blocks = []
    found = list(BLOCK.finditer(text))
    for match, after in zip_longest(found, found[1:]):
        if match[2] in LANGUAGES:
            follows = after is not None and after[2] == "text" and not text[match.end() : after.start()].strip()
            code = re.sub(rf"^{match[1]}", "", match[3], flags=re.MULTILINE)
            output = re.sub(rf"^{after[1]}", "", after[3], flags=re.MULTILINE) if after and follows else None
            blocks.append(Block(match[2], code, text.count("\n", 0, match.start()) + 2, output))
    return blocks


def all_pages() -> list[Page]:
    """Return the README and all pages of `docs/` that contain code."""
    skipped = {DOCS / "site", DOCS / "decisions"}
    paths = [path for path in sorted(DOCS.rglob("*.md")) if not skipped & set(path.parents)]
    return [page for path in [ROOT / "README.md", *paths] if (page := load_page(path)).blocks or page.pictures]
