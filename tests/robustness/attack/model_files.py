"""Saved models, `.pointray`: indices at their extremes, NaN and infinite floats, lies in headers, damaged bytes.

Every second input sets one integer of one index array to an extreme, in turn; the others are damaged at random. Rays
are cast at what loads: each must hit with finite numbers or miss.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pointray as pr
from attack import Attack, WrongError
from attack.casting import cast
from attack.mutate import WORDS, Rng, corrupt, extremes_of, pick, poison
from helpers.model_bytes import Saved, copied, join, split

# Index arrays, and how many of each come in a round. Spans are few, and a wrong one does most harm.
INDICES = {"spans": 3, "children": 2, "refs": 1, "order": 1, "borders": 1, "facing": 1, "colors": 1}
JSONS = (
    None,
    True,
    -1,
    0,
    1,
    2,
    2.5,
    1e308,
    float("nan"),
    float("inf"),
    "",
    "apss",
    "disc",
    [],
    {},
    [[]],
    10**30,
    "x" * 99,
)


def originals(folder: Path) -> list[Saved]:
    """Small models of every kind: all surfaces, with borders, sheets, colours, attributes and a level of detail.

    The last two have several leaves and nodes.
    """
    rng = np.random.default_rng(7)
    ball, more = _ball(rng, 24), _ball(rng, 100)
    flat = np.c_[rng.random((30, 2)), np.zeros(30)]
    up = np.tile([0.0, 0.0, 1.0], (30, 1))
    thin = np.concatenate([flat, flat + [0, 0, 0.02]])
    colors = rng.integers(0, 255, (24, 3), np.uint8)
    heat = {"heat": rng.random(24), "flow": rng.random((24, 2))}
    level = pr.Model(pr.Points(ball[:9], ball[:9], colors[:9], {k: v[:9] for k, v in heat.items()}), surface="paper")
    models = [
        pr.Model(pr.Points(ball, ball, colors, heat)),
        pr.Model(pr.Points(flat, up), refine=0),
        pr.Model(pr.Points(thin, np.concatenate([-up, up])), surface="imls", refine=3),
        pr.Model(pr.Points(flat + [5e6, 0, 0], up), surface="disc"),
        pr.Model(pr.Points(ball, ball), surface="paper", trim=None),
        pr.Model(pr.Points(more, more), radius_scale=0.4),
        pr.Model(
            pr.Points(np.concatenate([more[:60], 0.97 * more[:60]]), np.concatenate([more[:60], -more[:60]])),
            radius_scale=0.5,
        ),
    ]
    models[0].levels = (level,)
    out = []
    for model in models:
        model.save(folder / "a.pointray")
        out.append(split((folder / "a.pointray").read_bytes()))
    return out


def _ball(rng: Rng, n: int) -> NDArray[np.float64]:
    rows = rng.normal(size=(n, 3))
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def lengths_of(saved: Saved, name: str) -> int:
    """The number of items that the values of an index array may refer to."""
    prefix, _, field = name.rpartition("tree.")
    arrays = {key.removeprefix(f"{prefix}tree."): array.size for key, array in saved.arrays.items()}
    groups, blocks = arrays["refs"] // 16, arrays["blocks"] // 28
    counts = {"children": arrays["children"] // 8, "spans": groups, "refs": blocks}
    return counts.get(field, len(saved.arrays[f"{prefix}points.positions"]))


def all_extremes(files: list[Saved]) -> list[tuple[int, str, int, int]]:
    """Every integer of every index array at every extreme: (file, array, index, value).

    Arrays take turns (see `INDICES`). Within an array, files come in order, and the extremes of each are shuffled.
    """
    queues: dict[str, list[tuple[int, str, int, int]]] = {field: [] for field in INDICES}
    rng = np.random.default_rng(0)
    for k, saved in enumerate(files):
        mine: dict[str, list[tuple[int, str, int, int]]] = {field: [] for field in INDICES}
        for name, array in saved.arrays.items():
            if "tree." in name and name.rpartition(".")[2] in INDICES:
                mine[name.rpartition(".")[2]] += _extremes(k, name, array, lengths_of(saved, name))
        for field, found in mine.items():
            queues[field] += [found[i] for i in rng.permutation(len(found))]
    out, left = [], {field: iter(found) for field, found in queues.items()}
    for _ in range(sum(map(len, queues.values()))):
        for field, share in INDICES.items():
            out += itertools.islice(left[field], share)
    return out


def _extremes(k: int, name: str, array: NDArray[Any], length: int) -> list[tuple[int, str, int, int]]:
    out = []
    for at, value in enumerate(array.tolist()):
        partner = int(array[at ^ 1]) if (at ^ 1) < array.size else 0
        out += [(k, name, at, x) for x in extremes_of(array.dtype, length, partner) if x != value]
    return out


# -------------------------------------------------------------------------------------------------- other mutations


def poison_floats(rng: Rng, saved: Saved) -> None:
    floats = [name for name, array in saved.arrays.items() if array.dtype.kind == "f" and array.size]
    for _ in range(int(rng.integers(1, 4))):
        poison(rng, saved.arrays[pick(rng, floats)].reshape(-1), pick(rng, (0.0, 0.0, 0.0, 0.3, 1.0)))


def mix_indices(rng: Rng, saved: Saved) -> None:
    """Set several integers at once to extremes or to each other's values."""
    names = [name for name, array in saved.arrays.items() if array.dtype.kind == "i" and array.size]
    for _ in range(int(rng.integers(1, 6))):
        array = saved.arrays[pick(rng, names)].reshape(-1)
        at = int(rng.integers(array.size))
        values = (*extremes_of(array.dtype, array.size, int(array[at - 1])), int(array[at]) + 1, int(array[at]) - 1)
        good = [
            value for value in (*values, int(rng.choice(array))) if np.can_cast(np.min_scalar_type(value), array.dtype)
        ]
        array[at] = pick(rng, good)


def swap_bytes(rng: Rng, saved: Saved) -> None:
    name = pick(rng, [name for name, array in saved.arrays.items() if array.size])
    array = saved.arrays[name]
    content = bytearray(array.tobytes())
    for at in rng.integers(0, len(content), int(rng.integers(1, 9))):
        content[at] = int(rng.integers(256))
    saved.arrays[name] = np.frombuffer(bytes(content), array.dtype).reshape(array.shape).copy()


def change_lengths(rng: Rng, saved: Saved) -> None:
    name = pick(rng, list(saved.arrays))
    array = saved.arrays[name]
    kind = int(rng.integers(5))
    if kind == 0:
        saved.arrays[name] = array[:-1]
    elif kind == 1:
        saved.arrays[name] = np.concatenate([array, array])
    elif kind == 2:
        saved.arrays[name] = array[:0]
    elif kind == 3:
        saved.arrays[name] = array.astype(pick(rng, ("f8", "i8", "u1", "f4", "i4", ">f4", "c16", "S3", "M8[s]")))
    else:
        saved.arrays[name] = array.reshape(-1, 1) if array.ndim == 1 else array.T


def change_about(rng: Rng, saved: Saved) -> None:
    """Change or delete a value somewhere in the description, or swap two arrays."""
    parent: Any = saved.about
    while True:
        keys = list(parent) if isinstance(parent, dict) else list(range(len(parent)))
        if not keys:
            return
        key = pick(rng, keys)
        if isinstance(parent[key], dict | list) and rng.random() < 0.7:
            parent = parent[key]
            continue
        kind = int(rng.integers(4))
        if kind == 0:
            del parent[key]
        elif kind == 1 and isinstance(parent, list):
            other = int(rng.integers(len(parent)))
            parent[key], parent[other] = parent[other], parent[key]
        elif kind == 2 and isinstance(parent[key], int | float):
            parent[key] = pick(rng, (parent[key] + 1, -parent[key], parent[key] * 1e30, 17, 0))
        else:
            parent[key] = pick(rng, JSONS)
        return


def lie_header(rng: Rng) -> Callable[[int, bytes], bytes]:
    """Change the header of one array."""
    which = int(rng.integers(30))
    old, new = pick(
        rng,
        (
            (b"<f4", pick(rng, (b"<i4", b"<f8", b"|O ", b"|S0", b">f4", b"|V9"))),
            (b"<i4", pick(rng, (b"<f4", b"<i8", b"|u1", b"<M8"))),
            (b"(", pick(rng, (b"(-", b"(9", b"((", b"(0,"))),
            (b",)", pick(rng, (b"9,)", b"999999999999,)", b"0,)", b",2)", b",2,2)", b"*9,)", b"L,)"))),
            (b"False", pick(rng, (b"True ", b"None ", b"1"))),
            (b"shape", b"shade"),
            (b"{", pick(rng, (b"[", b"{{", b"(" * 50, b"\0"))),
        ),
    )

    def lie(k: int, header: bytes) -> bytes:
        return header.replace(old, new, 1) if k == which else header

    return lie


def anything(rng: Rng, saved: Saved) -> bytes:
    """A file that is damaged at random."""
    kind = rng.random()
    if kind < 0.7:
        changes = (poison_floats, poison_floats, poison_floats, mix_indices, mix_indices, swap_bytes, swap_bytes)
        mine = copied(saved)
        for _ in range(int(rng.integers(1, 3))):
            pick(rng, (*changes, change_lengths, change_about))(rng, mine)
        return join(mine)
    if kind < 0.8:
        return join(saved, lie_header(rng))
    data = corrupt(rng, join(saved))
    return data.replace(b"apss", pick(rng, WORDS).encode()[:4].ljust(4)) if kind > 0.97 else data


def begin(folder: Path) -> Attack:
    """Mutated saved models."""
    files, path = originals(folder), folder / "a.pointray"
    extremes = all_extremes(files)

    def attack(rng: Rng, index: int) -> bool:
        if index % 2 == 0:
            k, name, at, value = extremes[index // 2 % len(extremes)]
            saved = copied(files[k])
            saved.arrays[name].reshape(-1)[at] = value
            data = join(saved)
        else:
            data = anything(rng, pick(rng, files))
        path.unlink(missing_ok=True)
        path.write_bytes(data)
        try:
            model = pr.Model.load(path)
        except (ValueError, OSError) as error:
            if "\n" in str(error):
                raise WrongError(f"more than one line: {error}") from error
            return False
        cast(rng, model, exact=False)
        if model.levels:
            check_picture(from_afar(model))
        return True

    for saved in files:
        path.write_bytes(join(saved))
        model = pr.Model.load(path)
        cast(np.random.default_rng(0), model)
        from_afar(model)
    return attack


def from_afar(model: pr.Model) -> NDArray[np.float32]:
    """A picture whose pixels are as wide as the distance between points, so that levels of detail are shown."""
    scene = pr.Scene()
    scene.add(model)
    low, high = model.bounds
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low)) or 1.0
    camera = pr.Camera.look_at(middle + [0, -20 * size, size], middle, fov=4, size=(8, 8))
    return pr.render(scene, camera, pr.Settings("normal"))


def check_picture(picture: NDArray[np.float32]) -> None:
    """WrongError if a pixel is not finite."""
    if not np.isfinite(picture).all():
        raise WrongError("a pixel is not finite")
