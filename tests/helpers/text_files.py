"""Text with a point in each line, and damaged text."""

import numpy as np

XYZ = np.random.default_rng(3).uniform(-100, 100, (50, 3))

NORMALS = XYZ / np.linalg.norm(XYZ, axis=1, keepdims=True)

RGB = np.random.default_rng(4).integers(0, 256, (50, 3))

INTENSITY = np.random.default_rng(5).integers(-2000, 2000, (50, 1))


def save(path, *columns, header="", separator=" ", decimal="."):
    """Write columns, (50, k) each, with all digits."""
    rows = zip(*([[f"{v!r}" for v in row] for row in part.tolist()] for part in columns), strict=True)
    lines = [separator.join(v for part in row for v in part).replace(".", decimal) for row in rows]
    path.write_text(header + "\n".join(lines) + "\n")
    return path


def mutated(content, r):
    """A file's contents with some bytes changed, cut out, doubled or replaced."""
    content = bytearray(content)
    for _ in range(r.randrange(1, 4)):
        a, b = sorted(r.randrange(len(content) + 1) for _ in range(2))
        b = min(b, a + r.choice([1, 4, 50]))
        kind = r.randrange(5)
        content[a:b] = [
            bytes(r.randrange(256) for _ in range(b - a)),
            b"",
            bytes(content[a:b]) * r.choice([2, 30]),
            bytes(r.choice(b'0123456789.,;-+eE \t\r\n#/"nai') for _ in range(b - a)),
            r.choice([b"99999999999999999999999", b"1e999", b"\n\n", b"nan", b",", b"\r", b"-", b"\x1a", b"5\n"]),
        ][kind]
    return bytes(content)
