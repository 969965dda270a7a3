"""PTX files of two scans."""

TURNED = "0 1 0 0\n-1 0 0 0\n0 0 1 0\n10 20 30 1\n"  # row vectors: x becomes y

UNMOVED = "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"

AXES = "1 2 3\n1 0 0\n0 1 0\n0 0 1\n"


def scan(columns, rows, matrix, *lines):
    return f"{columns}\n{rows}\n{AXES}{matrix}" + "".join(f"{line}\n" for line in lines)


FIRST = scan(2, 2, TURNED, "1 0 0 0.5", "0 0 0 0.5", "0 1 0 0.25", "0 0 1 1")

SECOND = scan(1, 2, UNMOVED, "5 6 7 1", "8 9 10 1")


def save(folder, text):
    (folder / "a.ptx").write_bytes(text.encode())
    return folder / "a.ptx"
