"""Changes of point files: truncation, changed numbers and words, and damage behind valid checksums."""

from __future__ import annotations

import gzip
import io
import re
import struct
import zipfile
import zlib
from contextlib import suppress
from functools import cache

from attack.mutate import WORDS, Rng, corrupt, pick

NUMBERS = (0, 1, 2, 3, 127, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1)
HEADER, TAIL = 400, 3000  # bytes at both ends whose numbers readers use
TOKEN = re.compile(rb"[-+\w.]+")
PAGE = 1024  # bytes of a page of an E57 file, with a checksum in the last four


def change(rng: Rng, data: bytes, name: str, deep: bool = True) -> bytes:
    """A changed file. deep : whether what is packed or has a checksum may be changed below these"""
    if deep and rng.random() < 0.6:
        with suppress(Exception):  # the file is whole, but perhaps not of that kind
            below = _below(rng, data, name)
            if below is not None:
                return below
    kind = rng.random()
    if kind < 0.35:
        return corrupt(rng, data)
    return _words(rng, data) if is_text(data[:HEADER]) and kind < 0.8 else _numbers(rng, data)


def is_text(data: bytes) -> bool:
    """Whether bytes are text, of which a part may be a whole file."""
    return not set(data[:2000]) - set(range(32, 127)) - {9, 10, 13}


def _numbers(rng: Rng, data: bytes) -> bytes:
    """Change some numbers, mostly in the header, in tables at the end, or where the header points to."""
    out = bytearray(data)
    ends = [(0, min(HEADER, len(data))), (0, min(HEADER, len(data))), (max(len(data) - TAIL, 0), len(data))]
    for _ in range(int(rng.integers(1, 4))):
        low, high = pick(rng, [*ends, (0, len(data))])
        size = pick(rng, (1, 2, 4, 8))
        if high - low < size:
            continue
        at = int(rng.integers(low, high - size + 1))
        number = pick(rng, NUMBERS) if rng.random() < 0.6 else int(rng.integers(2**62))
        if rng.random() < 0.2:
            number = int.from_bytes(out[at : at + size], "little") + int(rng.integers(-2, 3))
        out[at : at + size] = (number % 256**size).to_bytes(size, "little")
    return bytes(out)


def _words(rng: Rng, data: bytes) -> bytes:
    """Change, remove or double some words or numbers of a text, half of them in the first lines."""
    for _ in range(int(rng.integers(1, 4))):
        span = data[:HEADER] if rng.random() < 0.5 else data
        found = list(TOKEN.finditer(span))
        if not found:
            break
        token, other = pick(rng, found), pick(rng, found)
        words = (pick(rng, WORDS).encode(), other.group(), b"", token.group() * 2, str(pick(rng, NUMBERS)).encode())
        data = data[: token.start()] + pick(rng, words) + data[token.end() :]
    return data


def _below(rng: Rng, data: bytes, name: str) -> bytes | None:
    """Change compressed data, with valid checksums; None if there is none."""
    if data[:2] == b"\x1f\x8b":
        return gzip.compress(change(rng, gzip.decompress(data), name, False), 1, mtime=0)
    if data[:4] == b"\x28\xb5\x2f\xfd":
        from backports import zstd

        return zstd.compress(change(rng, zstd.decompress(data), name, False))
    if data[:4] == b"PK\x03\x04":
        return _archive(rng, data, name)
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        return _picture(rng, data, name)
    if data[:8] == b"ASTM-E57":
        plain = b"".join(data[at : at + PAGE - 4] for at in range(0, len(data), PAGE))
        changed = change(rng, plain, name, False)[: len(plain)].ljust(len(plain), b"\0")
        rows = [changed[at : at + PAGE - 4] for at in range(0, len(changed), PAGE - 4)]
        return b"".join(row + struct.pack(">I", crc32c(row)) for row in rows)
    if data[:4] == b"glTF":
        return _binary_gltf(rng, data, name)
    return None


def _binary_gltf(rng: Rng, data: bytes, name: str) -> bytes:
    """The description or the numbers of a mesh are changed, and the lengths are right."""
    (length,) = struct.unpack_from("<I", data, 12)
    parts = [[data[16:20], data[20 : 20 + length]], [data[24 + length : 28 + length], data[28 + length :]]]
    hit = pick(rng, (0, 0, 1))
    parts[hit][1] = _words(rng, parts[0][1]) if hit == 0 else change(rng, parts[1][1], name, False)
    parts[0][1] += b" " * (-len(parts[0][1]) % 4)
    parts[1][1] += bytes(-len(parts[1][1]) % 4)
    body = b"".join(struct.pack("<I", len(content)) + kind + content for kind, content in parts)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def _archive(rng: Rng, data: bytes, name: str) -> bytes:
    """A member of an archive is changed."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as archive, zipfile.ZipFile(out, "w") as other:
        hit = pick(rng, archive.namelist())
        for info in archive.infolist():
            content = archive.read(info)
            other.writestr(info.filename, change(rng, content, name, False) if info.filename == hit else content)
    return out.getvalue()


def _picture(rng: Rng, data: bytes, name: str) -> bytes:
    """A part of a picture is changed; what is packed below it, too."""
    out, at, parts = data[:8], 8, []
    while at < len(data):
        (length,) = struct.unpack_from(">I", data, at)
        parts.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    hit = int(rng.integers(len(parts)))
    for k, (kind, content) in enumerate(parts):
        if k == hit and kind == b"IDAT" and rng.random() < 0.5:
            content = zlib.compress(corrupt(rng, zlib.decompress(content)))
        elif k == hit and content:
            content = _numbers(rng, content)
        out += struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
    return out


@cache
def _table() -> tuple[int, ...]:
    out = []
    for value in range(256):
        for _ in range(8):
            value = (value >> 1) ^ (0x82F63B78 if value & 1 else 0)
        out.append(value)
    return tuple(out)


@cache
def crc32c(row: bytes) -> int:
    """The checksum of a page; most pages of changed files are alike."""
    crc, table = 0xFFFFFFFF, _table()
    for byte in row:
        crc = (crc >> 8) ^ table[(crc ^ byte) & 255]
    return crc ^ 0xFFFFFFFF
