"""PLY files: random valid ones of every kind, with lies in the header, damage to rows, or damage to bytes.

An accepted file must have as many rows as its header says; it becomes a model, and rays are cast at it. A file that is
valid, or whose change has no meaning, must be accepted and give the positions that were written.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import pointray as pr
from attack import Attack, WrongError
from attack.casting import cast
from attack.mutate import WORDS, Rng, corrupt, pick

LARGEST_MODEL = 300  # points
# Letters of types in `struct`. PLY has two spellings of each type.
LETTERS = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}
LETTERS |= dict(
    zip(["int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64"], "bBhHiIfd", strict=True)
)
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
ENDS = ("\n", "\r\n", "\r")
COUNTS = ("0", "1", "-1", "1000000000", "999999999999999", "2147483648", "9223372036854775808", "x", "", "3.0", "1e3")


class Property(NamedTuple):
    """A property of an element. count : type of a list's length, or empty"""

    name: str
    type: str
    count: str = ""

    @property
    def line(self) -> str:
        return f"property {f'list {self.count} ' if self.count else ''}{self.type} {self.name}"


class Element(NamedTuple):
    """An element. rows : a number for each property, or several for a list"""

    name: str
    properties: list[Property]
    rows: list[list[float | list[float]]]


class Ply:
    """A PLY file that is being made.

    Attributes
    ----------
    positions : (n, 3) float32
        The positions that a reader must find.
    header : list of str
    body : list of list of bytes
        The rows of each element.
    """

    def __init__(self, rng: Rng) -> None:
        self.format, self.end = pick(rng, list(FORMATS)), pick(rng, ENDS)
        vertex, self.positions = _vertex(rng)
        before = [_other(rng, name) for name in ("grid", "strips") if rng.random() < 0.25]
        after = [_other(rng, "face")] if rng.random() < 0.5 else []
        self.elements = [*before, vertex, *after]
        self.header = ["ply", f"format {self.format} 1.0"]
        for element in self.elements:
            self.header += [f"element {element.name} {len(element.rows)}"]
            self.header += [one.line for one in element.properties]
        self.header += ["end_header"]
        self.body = [[self._row(element, row) for row in element.rows] for element in self.elements]

    @property
    def vertex(self) -> int:
        """Number of the vertex element."""
        return next(k for k, element in enumerate(self.elements) if element.name == "vertex")

    def _row(self, element: Element, row: list[float | list[float]]) -> bytes:
        out = b""
        for one, value in zip(element.properties, row, strict=True):
            if isinstance(value, list):
                out += self._number(one.count, len(value)) + b"".join(self._number(one.type, item) for item in value)
            else:
                out += self._number(one.type, value)
        return out.rstrip(b" ") + self.end.encode() if self.format == "ascii" else out

    def _number(self, type: str, value: float) -> bytes:
        letter = LETTERS[type]
        whole = letter not in "fd"
        if self.format == "ascii":
            return f"{int(value) if whole else repr(float(value))} ".encode()
        return struct.pack(FORMATS[self.format] + letter, int(value) if whole else value)

    def write(self) -> bytes:
        """The file."""
        return self.end.join([*self.header, ""]).encode("latin-1", "replace") + b"".join(map(b"".join, self.body))


def _vertex(rng: Rng) -> tuple[Element, NDArray[np.float32]]:
    """Vertices on a sphere, with their properties in any order and some unknown ones."""
    n, type = int(rng.integers(1, 41)), pick(rng, ("float", "double", "float32", "float64", "short", "int"))
    xyz = rng.normal(size=(n, 3))
    xyz = (xyz / np.linalg.norm(xyz, axis=1, keepdims=True)).astype(np.float32)
    if LETTERS[type] not in "fd":
        xyz = np.rint(xyz * 100).astype(np.float32)
    columns: dict[Property, list[float | list[float]]] = {}
    for k, name in enumerate("xyz"):
        columns[Property(name, type)] = xyz[:, k].tolist()
    if rng.random() < 0.5:
        for k, name in enumerate(pick(rng, (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z")))):
            columns[Property(name, "float")] = (xyz[:, k] / max(abs(xyz).max(), 1)).tolist()
    if rng.random() < 0.5:
        for name in pick(rng, (("red", "green", "blue"), ("r", "g", "b"))):
            columns[Property(name, "uchar")] = rng.integers(0, 256, n).tolist()
    if rng.random() < 0.3:
        columns[Property("heat", pick(rng, list(LETTERS)))] = rng.integers(0, 100, n).tolist()
    if rng.random() < 0.2:
        near: list[float | list[float]] = [list(range(int(rng.integers(4)))) for _ in range(n)]
        columns[Property("near", pick(rng, ("int", "uchar", "float")), pick(rng, ("uchar", "int", "ushort")))] = near
    order = [list(columns)[k] for k in rng.permutation(len(columns))]
    rows = [list(row) for row in zip(*(columns[one] for one in order), strict=True)]
    return Element("vertex", order, rows), xyz


def _other(rng: Rng, name: str) -> Element:
    """Faces, strips or a grid, with or without lists."""
    n = int(rng.integers(0, 5))
    properties = [Property("flag", "uchar")]
    if name != "grid":
        properties.insert(int(rng.integers(2)), Property("vertex_indices", "int", pick(rng, ("uchar", "int", "float"))))
    rows: list[list[float | list[float]]] = []
    for _ in range(n):
        row = [list(map(float, range(int(rng.integers(5))))) if one.count else 7.0 for one in properties]
        rows.append(row)
    return Element(name, properties, rows)


# --------------------------------------------------------------------------------------- what changes no meaning


def add_comments(rng: Rng, ply: Ply) -> None:
    for _ in range(int(rng.integers(1, 4))):
        line = pick(rng, ("comment made by hand", "obj_info num_cols 512", "comment M\xfcnchen \xe9", "comment"))
        ply.header.insert(int(rng.integers(2, len(ply.header))), line)


def add_spaces(rng: Rng, ply: Ply) -> None:
    k = int(rng.integers(1, len(ply.header) - 1))
    ply.header[k] = pick(rng, ("  ", "\t")).join(ply.header[k].split(" ")) + pick(rng, ("", " ", "\t"))


def nothing(rng: Rng, ply: Ply) -> None:
    pass


# ------------------------------------------------------------------------------------------------------ what does


def lie_count(rng: Rng, ply: Ply) -> None:
    k = pick(rng, [k for k, line in enumerate(ply.header) if line.startswith("element")])
    name, count = ply.header[k].split(" ")[1:]
    near = [str(int(count) + step) for step in (-2, -1, 1, 2)] if count.isdecimal() else []
    ply.header[k] = f"element {name} {pick(rng, (*COUNTS, *near, *near))}"


def lie_type(rng: Rng, ply: Ply) -> None:
    lines = [k for k, line in enumerate(ply.header) if line.startswith("property")]
    k = pick(rng, lines)
    words = ply.header[k].split()
    words[int(rng.integers(1, len(words) - 1)) if len(words) > 2 else -1] = pick(
        rng, (*LETTERS, "half", "list", "int64")
    )
    ply.header[k] = " ".join(words)


def lie_name(rng: Rng, ply: Ply) -> None:
    names = ("x", "y", "z", "vertex", "nx", "red", "radius", "face", "a" * 300, "gr\xf6\xdfe", "x\0y", "Vertex", "")
    k = pick(rng, [k for k, line in enumerate(ply.header) if line.startswith(("element", "property"))])
    words = ply.header[k].split(" ")
    words[1 if words[0] == "element" else -1] = pick(rng, names)
    ply.header[k] = " ".join(words)


def lie_format(rng: Rng, ply: Ply) -> None:
    ply.header[1] = f"format {pick(rng, (*FORMATS, 'weird', ''))} {pick(rng, ('1.0', '2.0', '', 'x'))}"


def move_lines(rng: Rng, ply: Ply) -> None:
    a, b = (int(rng.integers(len(ply.header))) for _ in range(2))
    kind = int(rng.integers(3))
    if kind == 0:
        ply.header[a], ply.header[b] = ply.header[b], ply.header[a]
    elif kind == 1:
        del ply.header[a]
    else:
        ply.header.insert(a, ply.header[b])


def add_line(rng: Rng, ply: Ply) -> None:
    lines = (
        "",
        "  ",
        "element",
        "property",
        "property list",
        "end_header",
        "x" * 5000,
        "element vertex 3",
        "ply",
        "\0",
    )
    more = (
        "property float x",
        "property list uchar int near",
        "property list float float w",
        "format ascii 1.0",
        "\x0b",
    )
    ply.header.insert(int(rng.integers(len(ply.header) + 1)), pick(rng, lines + more))


def change_number(rng: Rng, ply: Ply) -> None:
    """Change a number in a row, or perhaps the length of a list."""
    k = int(rng.integers(len(ply.body)))
    if not ply.body[k]:
        return
    row = int(rng.integers(len(ply.body[k])))
    data = ply.body[k][row]
    if ply.format == "ascii":
        words = data.decode("latin-1").rstrip("\r\n").split(" ")
        words[int(rng.integers(len(words)))] = pick(rng, WORDS)
        data = " ".join(words).encode("utf-8") + ply.end.encode()
    elif data:
        letter = pick(rng, "bBhHiIfd")
        number = pick(rng, (np.nan, np.inf, -np.inf, 1e30, -1.0, 0.0)) if letter in "fd" else -1
        value = struct.pack(FORMATS[ply.format] + letter.lower(), number)
        at = int(rng.integers(len(data)))
        data = (data[:at] + value + data[at + len(value) :])[: len(data)]
    ply.body[k][row] = data


def change_rows(rng: Rng, ply: Ply) -> None:
    """Add or remove a row, or add an empty or an overlong one."""
    k = int(rng.integers(len(ply.body)))
    rows = ply.body[k]
    at = int(rng.integers(len(rows) + 1))
    kind = int(rng.integers(4))
    if kind == 0 and at < len(rows):
        del rows[at]
    elif kind == 1 and rows:
        rows.insert(at, rows[at - 1])
    elif kind == 2:
        rows.insert(at, pick(rng, ENDS).encode())
    elif at < len(rows):
        rows[at] = b"1 " + rows[at]


SAME = (nothing, add_comments, add_spaces)
OTHER = (lie_count, lie_type, lie_name, lie_format, move_lines, add_line, change_number, change_number, change_rows)


def make_file(rng: Rng) -> tuple[bytes, Ply | None]:
    """A file, and the positions that it must give if it has to be accepted."""
    ply, kind = Ply(rng), rng.random()
    if kind < 0.15:
        pick(rng, SAME)(rng, ply)
        return ply.write(), ply
    if kind < 0.75:
        for _ in range(int(rng.integers(1, 4))):
            change: Callable[[Rng, Ply], None] = pick(rng, OTHER)
            with suppress(IndexError, ValueError):  # an earlier change has removed what this one changes
                change(rng, ply)
        data = ply.write()
        return (corrupt(rng, data, 1) if rng.random() < 0.1 else data), None
    return corrupt(rng, ply.write()), None


def begin(folder: Path) -> Attack:
    """Mutated PLY files."""
    path = folder / "a.ply"

    def attack(rng: Rng, index: int) -> bool:
        data, valid = make_file(rng)
        path.write_bytes(data)
        options = {"strict": bool(rng.random() < 0.5), "sample": pick(rng, (0, 0, None))}
        try:
            points = pr.read(path, **options)
        except (ValueError, OSError) as error:
            if valid is not None:
                raise WrongError(f"a valid file is refused: {error}") from error
            if "\n" in str(error):
                raise WrongError(f"more than one line: {error}") from error
            return False
        if valid is not None and options["sample"] == 0 and not np.array_equal(points.positions, valid.positions):
            raise WrongError("other positions than were written")
        if len(points) <= LARGEST_MODEL:
            try:
                model = pr.Model(points)
            except ValueError:
                return True
            cast(rng, model)
        return True

    _warm(folder)
    return attack


def _warm(folder: Path) -> None:
    """Compile the kernels before time is measured."""
    rng = np.random.default_rng(0)
    xyz = rng.normal(size=(30, 3))
    cast(rng, pr.Model(xyz / np.linalg.norm(xyz, axis=1, keepdims=True)))
