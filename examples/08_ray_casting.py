# python examples/08_ray_casting.py rays.png
#
# Ray casting with the interface of Open3D, after its tutorial of that name. With Open3D, the import would be
# `from open3d.t.geometry import RaycastingScene`, and triangles would be added instead of points.
import sys

import numpy as np

import pointray as pr
from pointray.compat import RaycastingScene

POINTS = 200_000
SIZE = (480, 600)


def numpy(values):
    """Return an array as it is, and a tensor of Open3D as an array."""
    return values.numpy() if hasattr(values, "numpy") else values


def answers(scene, width, height):
    """Ask a scene of either class about the rays of a picture, and return arrays of (height, width, ...)."""
    rays = numpy(
        scene.create_rays_pinhole(
            fov_deg=32, center=[0, 0, 1], eye=[-1.2, -4, 1.3], up=[0, 0, 1], width_px=width, height_px=height
        )
    )
    first = scene.cast_rays(rays)
    answer = {name: numpy(values) for name, values in first.items()}
    answer["crossings"] = numpy(scene.count_intersections(rays))

    # Rays from the hits to the sun show which of them are in shadow.
    hit = np.isfinite(answer["t_hit"])
    start = rays[..., :3] + rays[..., 3:] * np.where(hit, answer["t_hit"], 0)[..., None]
    sun = np.broadcast_to([0.8, -0.35, 0.45], start.shape)
    to_sun = np.concatenate([start + 0.01 * answer["primitive_normals"], sun], axis=-1).astype(np.float32)
    answer["shadow"] = numpy(scene.test_occlusions(to_sun))
    return {name: values[::-1] for name, values in answer.items()}  # the first row of rays is the lowest one


def picture(answer):
    """Colour the hits by their normals, darker in shadow."""
    colors = np.abs(answer["primitive_normals"]) * np.where(answer["shadow"], 0.35, 1)[..., None]
    return np.where(np.isfinite(answer["t_hit"])[..., None], colors, 0.8).astype(np.float32)


if __name__ == "__main__":
    scene = RaycastingScene()
    scene.add_points(pr.procedural("statue", POINTS))
    answer = answers(scene, *SIZE)
    hit = np.isfinite(answer["t_hit"])
    assert (answer["primitive_ids"][~hit] == RaycastingScene.INVALID_ID).all()
    print(f"{hit.mean():.0%} of the rays hit the statue, {answer['t_hit'][hit].min():.2f} away or more")
    pr.write_image(sys.argv[1], picture(answer))
