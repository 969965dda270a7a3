"""Render a scan with Mitsuba 3 as flat ellipsoids, path traced: python mitsuba_ellipsoids.py SCAN CAMERA.json PICTURE

Settings: https://mitsuba.readthedocs.io/en/stable/src/generated/plugins_shapes.html (ellipsoids from centers, scales
and quaternions). Semi-axes as Gaussian splatting starts with, the root mean square distance to the 3 nearest points,
and a tenth of it along the normal. No texture of Mitsuba reads attributes of ellipsoids, so colours need one in Python:
https://mitsuba.readthedocs.io/en/stable/src/others/custom_plugins.html.
"""

import json
import sys

import mitsuba as mi
import numpy as np
from plyfile import PlyData
from scipy.spatial import cKDTree

mi.set_variant("llvm_ad_rgb")


class PointColor(mi.Texture):
    def eval(self, si, active=True):
        return si.shape.eval_attribute_3("albedo", si, active)


mi.register_texture("point_color", PointColor)
scan, camera, picture = sys.argv[1:]
with open(camera) as file:
    view = json.load(file)
vertex = PlyData.read(scan)["vertex"]
centers = np.stack([vertex[name] for name in ("x", "y", "z")], axis=1)
normals = np.stack([vertex[name] for name in ("nx", "ny", "nz")], axis=1)
colors = (np.stack([vertex[name] for name in ("red", "green", "blue")], axis=1) / 255.0) ** 2.2
distances, _ = cKDTree(centers).query(centers, 4, workers=-1)
spacing = np.sqrt((distances[:, 1:] ** 2).mean(axis=1))
turns = np.column_stack([-normals[:, 1], normals[:, 0], np.zeros(len(normals)), 1.0001 + normals[:, 2]])  # z to normal
turns /= np.linalg.norm(turns, axis=1, keepdims=True)
eye, target, up = (np.array(view[name]) for name in ("eye", "target", "up"))
right = np.cross(target - eye, up) / np.linalg.norm(np.cross(target - eye, up))
forward = (target - eye) / np.linalg.norm(target - eye)
scene = mi.load_dict(
    {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4, "hide_emitters": True},
        "sensor": {
            "type": "perspective",
            "fov": view["fov"],
            "fov_axis": "y",
            "near_clip": 1e-3 * np.linalg.norm(target - eye),
            "far_clip": 1e3 * np.linalg.norm(target - eye),
            "to_world": mi.ScalarTransform4f().look_at(eye, target, up),
            "film": {"type": "hdrfilm", "width": view["size"][0], "height": view["size"][1], "pixel_format": "rgba"},
            "sampler": {"type": "multijitter", "sample_count": 16},
        },
        "sky": {"type": "constant", "radiance": 0.8},
        "sun": {"type": "directional", "direction": forward + 0.6 * right - 0.8 * up, "irradiance": 2.0},
        "scan": {
            "type": "ellipsoids",
            "extent": 1.0,
            "centers": mi.TensorXf(centers.astype(np.float32)),
            "scales": mi.TensorXf(np.outer(spacing, [1, 1, 0.1]).astype(np.float32)),
            "quaternions": mi.TensorXf(turns.astype(np.float32)),
            "albedo": mi.TensorXf(colors.astype(np.float32)),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "point_color"}},
        },
    }
)
image = np.array(mi.render(scene))
mi.util.write_bitmap(picture, image[..., :3] + 1 - image[..., 3:])
