"""Scene files whose words, numbers and lines are exchanged, doubled or removed, or whose bytes are damaged.

A file must be refused in one line, or its scene is rendered at 8 x 8 pixels. Some go through the command.
"""

from __future__ import annotations

import contextlib
import io
import re
import tomllib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import pointray as pr
from attack import Attack, WrongError
from attack.mutate import WORDS, Rng, corrupt, pick
from pointray.cli import execute
from pointray.scenefile import Plan, models

MOST_POINTS = 3000  # points: larger models, and those that take long to mesh, are not built
MESHED_FAST = ("sphere", "torus")
COMMAND = 0.05  # share of files that go through the command
SCENES = Path(__file__).with_name("scenes")
TEXTS = [(SCENES / name).read_text() for name in ("everything.toml", "framed.toml")]
TOKEN = re.compile(r'"[^"\n]*"|[-+]?[0-9][0-9_.eE]*|[A-Za-z_][\w]*|[\[\]{}=,.]')


def _listed(name: str) -> list[str]:
    """The lines of a file, with escapes as in Python."""
    return [line.encode().decode("unicode_escape") for line in (SCENES / name).read_text().splitlines()]


STRINGS = [*_listed("texts.txt"), "x" * 5000]  # values of a text
VALUES = [*_listed("values.txt"), "[" * 200]  # values behind a =
LINES = _listed("lines.txt")  # lines that may be added


def swap_token(rng: Rng, text: str) -> str:
    """Replace a word, number, text or sign."""
    tokens = list(TOKEN.finditer(text))
    if not tokens:
        return text
    token = pick(rng, tokens)
    kind = int(rng.integers(6))
    if kind == 0:
        new = pick(rng, WORDS)
    elif kind == 1:
        new = f'"{pick(rng, STRINGS)}"'
    elif kind == 2:
        new = pick(rng, tokens)[0]
    elif kind == 3:
        new = pick(rng, VALUES)
    elif kind == 4:
        new = ""
    else:
        new = token[0] * 2
    return text[: token.start()] + new + text[token.end() :]


def swap_value(rng: Rng, text: str) -> str:
    """Replace the value behind a =."""
    matches = list(re.finditer(r"= ([^\n]*)", text))
    if not matches:
        return text
    match = pick(rng, matches)
    values = (*VALUES, *(f'"{value}"' for value in STRINGS), *WORDS, *(other[1] for other in matches))
    return text[: match.start(1)] + pick(rng, values) + text[match.end(1) :]


def scale_number(rng: Rng, text: str) -> str:
    """Make a number a little or a lot larger or smaller; often it is still valid."""
    numbers = list(re.finditer(r"(?<![\w.\"])-?\d+(\.\d+)?", text))
    if not numbers:
        return text
    number = pick(rng, numbers)
    factor = pick(rng, (0.0, -1.0, 0.5, 2.0, 10.0, 1e-9, 1e9, 1e17, 1e-38, 1e38))
    value = float(number[0]) * factor
    new = str(int(value)) if "." not in number[0] and abs(value) < 1e19 and value == int(value) else repr(value)
    return text[: number.start()] + new + text[number.end() :]


def move_lines(rng: Rng, text: str) -> str:
    lines = text.split("\n")
    a, b, length = int(rng.integers(len(lines))), int(rng.integers(len(lines))), int(rng.integers(1, 8))
    part = lines[a : a + length]
    if rng.random() < 0.6:
        del lines[a : a + length]
    if rng.random() < 0.7:
        lines[b:b] = part
    return "\n".join(lines)


def add_line(rng: Rng, text: str) -> str:
    lines = text.split("\n")
    lines.insert(int(rng.integers(len(lines) + 1)), pick(rng, LINES))
    return "\n".join(lines)


def nest(rng: Rng, text: str) -> str:
    """Put a value deep into brackets, or make a name of many parts."""
    depth = pick(rng, (1, 2, 30, 500, 3000))
    if rng.random() < 0.3:
        return f"{'a.' * depth}b = 1\n{text}"
    matches = list(re.finditer(r"= ([^\n]*)", text))
    if not matches:
        return text
    match = pick(rng, matches)
    return f"{text[: match.start(1)]}{'[' * depth}{match[1]}{']' * depth}{text[match.end(1) :]}"


CHANGES: tuple[Callable[[Rng, str], str], ...] = (
    *(swap_token, swap_token, swap_value, swap_value, swap_value, scale_number, scale_number, scale_number),
    *(move_lines, add_line, add_line, nest),
)

MILD = (scale_number, move_lines)  # the result is often still a scene


def make_file(rng: Rng) -> bytes:
    text, kind = pick(rng, TEXTS), rng.random()
    if kind < 0.02:
        return text.encode()
    if kind < 0.1:
        return corrupt(rng, text.encode())
    for _ in range(pick(rng, (1, 1, 1, 2, 3))):
        text = pick(rng, MILD if rng.random() < 0.4 else CHANGES)(rng, text)
    data = text.encode("utf-8", "surrogatepass")
    return corrupt(rng, data, 1) if kind < 0.2 else data


def make_folder(folder: Path) -> None:
    """Files that the scene files name: a scan, a saved model, instances, and a picture of the sky."""
    rng = np.random.default_rng(11)
    rows = rng.normal(size=(80, 3))
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    pr.write(folder / "scan.ply", pr.Points(0.5 * rows, rows, attributes={"heat": rows[:, 0]}))
    pr.Model(pr.Points(0.4 * rows, rows)).save(folder / "ready.pointray")
    many = np.tile(np.eye(4), (3, 1, 1))
    many[:, 0, 3] = -2, 0, 2
    np.save(folder / "many.npy", many)
    pixels = rng.integers(100, 130, (8, 16, 4), np.uint8)
    (folder / "sky.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 16\n" + pixels.tobytes())


def is_small(data: dict[str, Any]) -> bool:
    """Whether no model takes long to make."""
    recipes = [one for one in data.get("models", {}).values() if "procedural" in one]
    return all(one["points"] <= MOST_POINTS and one["procedural"] in MESHED_FAST for one in recipes)


def run_command(path: Path, picture: Path) -> bool:
    """Whether the command renders it; WrongError if it prints more than a line, or if its status is not 0 or 2."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = execute(["render", str(path), "-o", str(picture), "--size", "8x8", "--spp", "1"])
    lines = [line for line in err.getvalue().splitlines() if "note: " not in line]
    if status not in (0, 2):
        raise WrongError(f"exit status {status}: {lines}")
    if len(lines) != (status == 2):
        raise WrongError(f"exit status {status} with {len(lines)} lines: {lines[:2]}")
    return status == 0


def begin(folder: Path) -> Attack:
    """Mutated scene files."""
    make_folder(folder)
    models.procedural = lru_cache(64)(models.procedural)  # the same few points would take 0.2 s each time
    path, picture = folder / "scene.toml", folder / "a.png"

    def attack(rng: Rng, index: int) -> bool:
        path.write_bytes(make_file(rng))
        try:
            plan = Plan(path)
        except (ValueError, OSError) as error:
            if "\n" in str(error):
                raise WrongError(f"more than one line: {error}") from error
            return run_command(path, picture) if rng.random() < COMMAND else False
        if not is_small(tomllib.loads(path.read_text(encoding="utf-8-sig"))):
            return True
        calm = {"spp": 1, "time_limit": None, "noise": None, "denoise": False}
        endless = plan.settings.time_limit is not None or plan.settings.noise is not None or plan.settings.denoise
        if not endless and rng.random() < COMMAND:
            return run_command(path, picture)
        try:
            plan.change({"size": (8, 8)}, calm, {})
            made = plan.build()
            image = pr.render(*made[:3])
        except (ValueError, OSError) as error:
            if "\n" in str(error):
                raise WrongError(f"more than one line: {error}") from error
            return False
        if not np.isfinite(image).all():
            raise WrongError("a pixel is not finite")
        return True

    _warm(path)
    return attack


def _warm(path: Path) -> None:
    """Compile the kernels of all integrators and models before time is measured."""
    for text in TEXTS:
        path.write_text(text)
        plan = Plan(path)
        plan.change({"size": (8, 8)}, {"spp": 1, "time_limit": None, "noise": None}, {})
        scene, camera, _, _, _ = plan.build()
        for integrator in ("phong", "ao", "path", "normal", "depth", "color", "cost"):
            pr.render(scene, camera, pr.Settings(integrator, spp=2))
