"""What an E57 file says of itself: its XML section, read here before libE57 sees the file.

libE57 believes what it is told: how many points there are, where they lie, how deep elements are nested, and which
schema to fetch from where. All of that is checked here first.
"""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO
from xml.parsers import expat

MAGIC = b"ASTM-E57"
HEADER = struct.Struct("<8sIIQQQQ")  # magic, version, subversion, bytes of the file, where XML begins, its length, page
PAGE, PAYLOAD = 1024, 1020  # bytes of a page; the last four are its checksum
LONGEST_XML = 64 << 20
MOST_ELEMENTS = 1 << 18
DEEPEST = 64
SCHEMA = re.compile(r"schemaLocation$", re.IGNORECASE)


class Node:
    """An element of XML, with names as they stand there: prefix and name."""

    def __init__(self, name: str, attributes: dict[str, str]) -> None:
        self.name, self.attributes = name, attributes
        self.children: list[Node] = []
        self.parts: list[str] = []

    @property
    def text(self) -> str:
        return "".join(self.parts).strip()

    def __iter__(self) -> Iterator[Node]:
        return iter(self.children)

    def find(self, path: str) -> Node | None:
        """The element at a path like "pose/rotation"; None if there is none."""
        node: Node | None = self
        for name in path.split("/"):
            node = next((child for child in node or () if child.name == name), None)
        return node

    def text_at(self, path: str) -> str:
        """The text of the element at a path; "" if there is none."""
        node = self.find(path)
        return node.text if node else ""

    def number_at(self, path: str, missing: float) -> float:
        """The number of the element at a path; an empty element stands for 0."""
        node = self.find(path)
        return missing if node is None else to_number(node.text or "0", node.name)


def to_number(text: str, name: str) -> float:
    """A float; ValueError names the element."""
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"is damaged: {name} is {text[:40]!r}, which is no number") from None


def to_whole(node: Node, name: str, missing: int | None = None) -> int:
    """A whole number among the attributes of an element; ValueError if it is none, or is missing."""
    text = node.attributes.get(name, "" if missing is None else str(missing)).strip()
    if not re.fullmatch(r"[+-]?[0-9]{1,19}", text) or not -(2**63) <= int(text) < 2**63:
        raise ValueError(f"is damaged: {name} of {node.name} is {text[:40]!r}, which is no whole number")
    return int(text)


def read_xml(path: Path) -> tuple[Node, int]:
    """The root of a file's XML, and the file's size in bytes; ValueError says what is wrong with the header."""
    with path.open("rb") as file:
        size = file.seek(0, io.SEEK_END)
        file.seek(0)
        head = file.read(HEADER.size)
        if len(head) < HEADER.size:
            raise ValueError(f"is cut off: it has {size} bytes, the header alone has {HEADER.size}")
        magic, version, _, announced, offset, length, page = HEADER.unpack(head)
        if magic != MAGIC:
            raise ValueError(f"is no E57 file: it begins with {magic!r}")
        if version != 1 or page != PAGE:
            raise ValueError(f"has version {version} with pages of {page} bytes; can read version 1 with {PAGE}")
        if announced != size:
            raise ValueError(f"is cut off or still being written: the header says {announced:,} bytes, it has {size:,}")
        return _parse(_pages(file, size, offset, length)), size


def _pages(file: BinaryIO, size: int, offset: int, length: int) -> bytes:
    """Bytes of the file without the checksums of its pages."""
    if not HEADER.size <= offset < size or offset % PAGE >= PAYLOAD:
        raise ValueError(f"is damaged: its XML is said to begin at byte {offset:,} of {size:,}")
    if length > min(LONGEST_XML, size - offset):
        raise ValueError(f"is damaged: its XML, at byte {offset:,} of {size:,}, is said to have {length:,} bytes")
    file.seek(offset - offset % PAGE)
    pages = file.read((length // PAYLOAD + 2) * PAGE)
    data = b"".join(pages[start : start + PAYLOAD] for start in range(0, len(pages), PAGE))
    return data[offset % PAGE :][:length]


def _parse(data: bytes) -> Node:
    stack = [Node("", {})]
    count = 0

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if len(stack) > DEEPEST or count > MOST_ELEMENTS:
            raise ValueError(f"has more than {MOST_ELEMENTS:,} elements of XML, or they are nested {DEEPEST} deep")
        if any(SCHEMA.search(key) for key in attributes):
            raise ValueError("names a schema for its XML, which is not followed")
        node = Node(name, attributes)
        stack[-1].children.append(node)
        stack.append(node)

    def no_types(*_: Any) -> None:
        raise ValueError("declares types or entities in its XML, which are not followed")

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: stack.pop()
    parser.CharacterDataHandler = lambda text: stack[-1].parts.append(text)
    parser.StartDoctypeDeclHandler = no_types
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, LookupError) as error:  # LookupError: an encoding that Python lacks
        raise ValueError(f"is damaged: its XML: {error}") from None
    return stack[0].children[0]
