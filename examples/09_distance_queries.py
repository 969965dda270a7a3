# python examples/09_distance_queries.py distances.png
#
# Distances from a surface with the interface of Open3D, after its tutorial on distance queries. With Open3D, the import
# would be `from open3d.t.geometry import RaycastingScene`, and triangles would be added instead of points.
import sys

import numpy as np

import pointray as pr
from pointray.compat import RaycastingScene

POINTS = 200_000
SIZE = (480, 600)


def numpy(values):
    """Return an array as it is, and a tensor of Open3D as an array."""
    return values.numpy() if hasattr(values, "numpy") else values


def slice_through(low, high, width, height):
    """Return positions in the plane y = 0 from (low[0], low[1]) to (high[0], high[1]) in x and z, top row first."""
    x, z = np.meshgrid(np.linspace(low[0], high[0], width), np.linspace(high[1], low[1], height))
    return np.stack([x, np.zeros_like(x), z], axis=-1).astype(np.float32)


def answers(scene, queries):
    """Ask a scene of either class about positions, (..., 3)."""
    nearest = scene.compute_closest_points(queries)
    return {
        "distance": numpy(scene.compute_distance(queries)),
        "signed": numpy(scene.compute_signed_distance(queries)),
        "inside": numpy(scene.compute_occupancy(queries)),
        "nearest": numpy(nearest["points"]),
        "normal": numpy(nearest["primitive_normals"]),
    }


def picture(answer, spacing=0.05):
    """Draw contour lines of the signed distance, blue inside and brown outside."""
    color = np.where(answer["inside"][..., None] > 0, [0.15, 0.3, 0.7], [0.75, 0.55, 0.3])
    bands = 0.55 + 0.45 * np.abs(np.mod(answer["signed"] / spacing, 1) * 2 - 1)
    return (color * bands[..., None]).astype(np.float32)


if __name__ == "__main__":
    scene = RaycastingScene()
    scene.add_points(pr.procedural("statue", POINTS))
    answer = answers(scene, slice_through((-0.75, -0.1), (0.75, 2.1), *SIZE))
    print(f"{answer['inside'].mean():.0%} of the slice are inside, at most {-answer['signed'].min():.2f} deep")
    pr.write_image(sys.argv[1], picture(answer))
