"""XML section of an E57 file, read here before libE57 opens the file.

libE57 trusts the file: the number and place of points, the nesting of elements, and the address of a schema to fetch.
All of these are checked here first.
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
HEADER = struct.Struct("<8sIIQQQQ")  # magic, version, subversion, file size, offset and length of the XML, page size
PAGE, PAYLOAD = 1024, 1020  # bytes of a page; its last four bytes are a checksum
LONGEST_XML = 64 << 20
MOST_ELEMENTS = 1 << 18
DEEPEST = 64
SCHEMA = re.compile(r"schemaLocation$", re.IGNORECASE)


class Node:
    """An XML element: its name with the namespace prefix, its attributes, children, and pieces of text (`parts`)."""

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
        """Return the element at a path like "pose/rotation"; None if it is missing."""
        node: Node | None = self
        for name in path.split("/"):
            node = next((child for child in node or () if child.name == name), None)
        return node

    def text_at(self, path: str) -> str:
        """Return the text of the element at a path; "" if it is missing."""
        node = self.find(path)
        return node.text if node else ""

    def number_at(self, path: str, missing: float) -> float:
        """Return the number in the element at a path like "pose/rotation/w".

        missing : returned if there is no element; an empty element means 0
        """
        node = self.find(path)
        return missing if node is None else to_number(node.text or "0", node.name)


def to_number(text: str, name: str) -> float:
    """Convert a text to float; raise ValueError for other texts. name : of the XML element, for the message"""
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"is damaged: {name} is {text[:40]!r}, not a number") from None


def to_whole(node: Node, name: str, missing: int | None = None) -> int:
    """Return an attribute of an XML element as an integer of 64 bits; raise ValueError if it is invalid.

    name : of the attribute; missing : value if it is not stated; None: ValueError
    """
    text = node.attributes.get(name, "" if missing is None else str(missing)).strip()
    if not re.fullmatch(r"[+-]?[0-9]{1,19}", text) or not -(2**63) <= int(text) < 2**63:
        raise ValueError(f"is damaged: {name} of {node.name} is {text[:40]!r}, not an integer")
    return int(text)


def read_xml(path: Path) -> tuple[Node, int]:
    """Return the root of a file's XML, and the file size in bytes; raise ValueError if the header is invalid."""
    with path.open("rb") as file:
        size = file.seek(0, io.SEEK_END)
        file.seek(0)
        head = file.read(HEADER.size)
        if len(head) < HEADER.size:
            raise ValueError(f"is cut off: it has {size} bytes, the header needs {HEADER.size}")
        magic, version, _, announced, offset, length, page = HEADER.unpack(head)
        if magic != MAGIC:
            raise ValueError(f"is not an E57 file: it begins with {magic!r}")
        if version != 1 or page != PAGE:
            raise ValueError(f"unsupported version {version} with pages of {page} bytes; expected 1 with {PAGE}")
        if announced != size:
            raise ValueError(f"is cut off or incomplete: expected {announced:,} bytes, found {size:,}")
        return _parse(_pages(file, size, offset, length)), size


def _pages(file: BinaryIO, size: int, offset: int, length: int) -> bytes:
    """Return the XML section of a file without the checksums that each page of the file has.

    Raise ValueError if the stated offset or length of the section is invalid.

    size : bytes of the file; offset, length : place of the section as stated in the file, in bytes
    """
    if not HEADER.size <= offset < size or offset % PAGE >= PAYLOAD:
        raise ValueError(f"is damaged: invalid start of its XML, byte {offset:,} of {size:,}")
    if length > min(LONGEST_XML, size - offset):
        raise ValueError(f"is damaged: its XML, at byte {offset:,} of {size:,}, has invalid length {length:,} bytes")
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
            raise ValueError(f"has more than {MOST_ELEMENTS:,} XML elements, or more than {DEEPEST} nested ones")
        if any(SCHEMA.search(key) for key in attributes):
            raise ValueError("refers to an XML schema, which is unsupported")
        node = Node(name, attributes)
        stack[-1].children.append(node)
        stack.append(node)

    def no_types(*_: Any) -> None:
        raise ValueError("declares XML types or entities, which are unsupported")

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: stack.pop()
    parser.CharacterDataHandler = lambda text: stack[-1].parts.append(text)
    parser.StartDoctypeDeclHandler = no_types
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, LookupError) as error:  # LookupError: unknown encoding
        raise ValueError(f"is damaged: its XML: {error}") from None
    return stack[0].children[0]
