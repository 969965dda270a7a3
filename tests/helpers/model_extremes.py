"""A program that sets every integer of a saved model to its extremes and traces what loads. It must not crash.

    python tests/helpers/model_extremes.py FOLDER

It prints how many of the changed models were refused, and how many loaded.
"""

import sys
from pathlib import Path

import numpy as np

import pointray as pr

LEAST, GREATEST = -(2**31), 2**31 - 1
ROWS = 120
NAMES = ("children", "spans", "refs", "order")


def values(array: np.ndarray, index: int, length: int) -> set[int]:
    """Values for the integer at an index: extremes, these less its neighbour, and numbers around a length."""
    out = {LEAST, LEAST + 1, -2, -1, 0, length - 1, length, length + 1, GREATEST - 1, GREATEST}
    for beside in (index ^ 1, index):
        partner = int(array[beside]) if beside < array.size else 0
        out |= {GREATEST - partner, GREATEST - partner + 1, LEAST + partner, LEAST - partner}
    return {value for value in out if LEAST <= value <= GREATEST}


def rays() -> tuple[np.ndarray, np.ndarray]:
    """A tile of like rays, and single ones."""
    rng = np.random.default_rng(0)
    like = np.stack([*np.meshgrid(np.linspace(-1, 1, 8), np.linspace(-1, 1, 8))] + [np.full((8, 8), -5.0)], axis=-1)
    origins = np.concatenate([like.reshape(-1, 3), rng.normal(size=(16, 3)) * 3])
    directions = np.concatenate([np.tile([0.0, 0.0, 1.0], (64, 1)), -origins[64:]])
    return origins, directions


def main(folder: Path) -> None:
    rng = np.random.default_rng(1)
    sphere = pr.procedural("sphere", ROWS)
    points = pr.Points(sphere.positions, sphere.normals, attributes={"a": rng.random(ROWS)})
    file = folder / "m.pointray"
    pr.Model(points).save(file)
    origins, directions = rays()
    refused = loaded = 0
    for name in NAMES:
        model = pr.Model.load(file)
        array = getattr(model.tree, name)
        lengths = {"children": model.tree.boxes.size // 48, "spans": model.tree.spheres.size // 64}
        lengths |= {"refs": model.tree.blocks.size // 28, "order": len(model.points)}
        for index in range(array.size):
            before = int(array[index])
            for value in values(array, index, lengths[name]):
                array[index] = value
                model.save(folder / "changed.pointray")
                try:
                    changed = pr.Model.load(folder / "changed.pointray")
                except ValueError:
                    refused += 1
                    continue
                loaded += 1
                scene = pr.Scene()
                scene.add(changed)
                hits = scene.intersect(origins, directions, attributes=("a",))
                scene.occluded(origins, directions)
                assert ((hits.point >= -1) & (hits.point < ROWS)).all()
            array[index] = before
    print(refused, loaded)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
