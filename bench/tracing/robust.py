"""Count the hits that depend on slabs, boxes and the size of voxels, for every cloud given.

    python -m bench.tracing.robust scan.ply ... [--surface apss] [--size 600] [--level v3]

The tree as shipped is compared with the same tree with unlimited slabs and boxes, and with trees of half and of twice
the voxel size, over camera rays from four sides. The program prints how many rays hit in one and miss in the other, and
the largest and the 99.99th percentile difference of t in units of the mean radius.
"""

from __future__ import annotations

import argparse
import warnings

import numpy as np

import pointray as pr
from bench.helpers.levels import add_level, restart_at
from pointray.model.model import PrebuiltModel
from pointray.surface.tree.build import build_tree
from pointray.surface.tree.parts import splats_of
from pointray.surface.tree.settings import LEAF_WIDTH

SIDES = ((0.45, -1.0, 0.35), (-1.0, 0.3, 0.2), (0.2, 1.0, -0.3), (0.1, 0.2, 1.0))


def rebuilt(model: pr.Model, **changes: object) -> pr.Model:
    """The same model over another tree."""
    tree = build_tree(splats_of(model.tree, model.radii), model.settings._replace(**changes), in_order=True)
    return PrebuiltModel(model.data._replace(tree=tree))


def depths(model: pr.Model, size: int) -> np.ndarray:
    """t of the camera rays from four sides; inf for a miss."""
    scene = pr.Scene()
    scene.add(model)
    views = [pr.Camera.frame(model.bounds, side, size=(size, size)).rays() for side in SIDES]
    return np.concatenate([scene.intersect(*rays).t.reshape(-1) for rays in views])


def compare(a: np.ndarray, b: np.ndarray, radius: float) -> str:
    """Differing rays, and differences of t where both hit."""
    hit_a, hit_b = np.isfinite(a), np.isfinite(b)
    both = hit_a & hit_b
    gap = np.abs(a[both] - b[both]) / radius
    return (
        f"{(hit_a != hit_b).sum():6d} of {hit_a.sum():8d} hits differ, t by over 2%: {(gap > 0.02).sum():6d}, "
        f"most {gap.max(initial=0):8.4f}"
    )


def main() -> None:
    """Print a line for each cloud and change."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+")
    parser.add_argument("--surface", default=None)
    parser.add_argument("--size", type=int, default=600)
    add_level(parser)
    options = parser.parse_args()
    restart_at(options.level, "bench.tracing.robust")
    warnings.simplefilter("ignore")
    for name in options.files:
        model = pr.Model(pr.read(name), surface=options.surface, scatter="surface")
        radius = float(np.median(model.radii))
        shipped = depths(model, options.size)
        print(f"{name.rsplit('/')[-1]}  {len(model.points):,} points, surface {model.surface}", flush=True)
        for label, changes in (
            ("unlimited slabs and boxes", {"cut": False}),
            ("voxels of half the size", {"leaf_width": LEAF_WIDTH / 2}),
            ("voxels of twice the size", {"leaf_width": LEAF_WIDTH * 2}),
        ):
            print(
                f"   {label:28s}", compare(shipped, depths(rebuilt(model, **changes), options.size), radius), flush=True
            )


if __name__ == "__main__":
    main()
