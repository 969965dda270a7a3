"""The process to which `interrupts` sends signals: it works for ever, catches each KeyboardInterrupt and goes on.

It prints "in STAGE" before each piece of work, and "interrupted" when it has caught an interrupt.
"""

from __future__ import annotations

import sys
import warnings
from contextlib import suppress

import numpy as np

import pointray as pr

POINTS = 4000


def main() -> None:
    warnings.simplefilter("ignore")
    rng = np.random.default_rng(int(sys.argv[1]))
    rows = rng.normal(size=(POINTS, 3))
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    bare, whole = pr.Points(rows), pr.Points(rows, rows)
    model = pr.Model(whole)
    scene = pr.Scene()
    scene.add(model)
    camera = pr.Camera.frame(model.bounds, size=(96, 96))
    origins, directions = camera.rays()
    work = {
        "model": lambda: pr.Model(bare),
        "radii": lambda: pr.Model(whole),
        "normals": lambda: pr.estimate_normals(bare),
        "levels": lambda: pr.Model(whole).make_levels(),
        "render": lambda: pr.render(scene, camera, pr.Settings("path", spp=4)),
        "intersect": lambda: scene.intersect(origins, directions),
    }
    for do in work.values():  # this compiles the kernels before the first signal
        do()
    print("ready", flush=True)
    while True:
        with suppress(KeyboardInterrupt):  # a signal that comes while another is reported
            try:
                while True:
                    name = str(rng.choice(list(work)))
                    print("in", name, flush=True)
                    work[name]()
            except KeyboardInterrupt:
                print("interrupted", flush=True)


if __name__ == "__main__":
    main()
