"""Lines at the beginning of a text file: comments, header and rows."""

from __future__ import annotations

import re
from typing import BinaryIO, NamedTuple

COMMENT = re.compile(r"\s*(#|//)")
FIELDS = re.compile(r'[\s,;"]+')
PLAIN = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)(e[+-]?\d+)?|[+-]?(nan|inf)|[+-]?1\.#\w+", re.IGNORECASE)
UTF8, UTF16 = b"\xef\xbb\xbf", (b"\xff\xfe", b"\xfe\xff")
BINARY = bytes({*range(32)} - {9, 10, 11, 12, 13, 26})
BLOCK = 1 << 22  # bytes of text parsed at a time
LONGEST = 1 << 20  # maximum bytes of a line
SHOWN = 60  # maximum length of a line quoted in a message


class Top(NamedTuple):
    """Lines before the rows of a text, and the first rows.

    Attributes
    ----------
    comments : list of str
    header : str or None
        The first line that is neither comment, row nor number: perhaps the names of the columns.
    announced : int or None
        Number of rows, stated in a line of its own.
    rows : list of (int, str)
        Offset and text of each line from the first row on.
    """

    comments: list[str]
    header: str | None
    announced: int | None
    rows: list[tuple[int, str]]


def numbers_in(line: str) -> list[bool]:
    """Return for each field of a line whether it looks like a number."""
    return [PLAIN.fullmatch(field) is not None for field in FIELDS.split(line.strip(' \t,;"')) if field]


def is_row(line: str) -> bool:
    """Whether a line has at least three numbers; it may contain words too."""
    return sum(numbers_in(line)) >= 3


def top_of(text: bytes, begin: int = 0) -> Top:
    """Classify the lines at the beginning of a file as comments, header, number of rows and rows, which may be missing.

    begin : offset of the first line
    """
    comments: list[str] = []
    header: str | None = None
    announced: int | None = None
    lines = lines_of(text[begin:])
    for k, (_, line) in enumerate(lines):
        if COMMENT.match(line):
            comments.append(line)
        elif is_row(line):
            return Top(comments, header, announced, [(at + begin, line) for at, line in lines[k:]])
        elif announced is None and re.fullmatch(r"\s*\d{1,18}\s*", line):
            announced = int(line)
        elif header is None:
            header = line
        else:
            break
    return Top(comments, header, announced, [])


def lines_of(text: bytes) -> list[tuple[int, str]]:
    """Return the offset and text of each line that is not blank; the last one may be incomplete."""
    found = re.finditer(rb"[^\r\n]+", text)
    return [(m.start(), m[0].decode("latin-1")) for m in found if m[0].strip(b" \t")]


def shortened(text: str) -> str:
    """Return a text quoted and shortened for a message."""
    text = text.strip()
    return repr(text if len(text) <= SHOWN else text[:SHOWN] + "...")


def is_binary(head: bytes) -> bool:
    """Whether the beginning of a file is not text with one byte per character."""
    return len(head.translate(None, BINARY)) < len(head)


def is_ptx(head: bytes) -> bool:
    """Whether a file begins like PTX: two lines with an integer each, then a line with three words.

    head : first bytes of the file
    """
    return re.match(rb"(\s*\d+[ \t]*(\r\n|\r|\n)){2}[ \t]*\S+[ \t]+\S+[ \t]+\S+[ \t]*[\r\n]", head) is not None


def line_at(file: BinaryIO, offset: int) -> tuple[int, str, int]:
    """Return the number, from 1, and the text of the line at an offset, and the offset's position within it.

    Of a very long line only the part near the offset is returned.
    """
    file.seek(0)
    number, left, start, last = 1, offset, 0, b""
    while left > 0 and (text := file.read(min(left, BLOCK))):
        number += text.count(b"\n") + text.count(b"\r") - text.count(b"\r\n") - (last == b"\r" and text[:1] == b"\n")
        end = max(text.rfind(b"\n"), text.rfind(b"\r"))
        start = offset - left + end + 1 if end >= 0 else start
        left -= len(text)
        last = text[-1:]
    start = max(start, offset - LONGEST)
    file.seek(start)
    line = file.read(offset - start + 10 * SHOWN)
    within = offset - start
    ends = [end for end in (line.find(b"\n", within), line.find(b"\r", within)) if end >= 0]
    return number, line[: min(ends, default=len(line))].decode("latin-1"), within
