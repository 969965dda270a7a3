"""Render a scan with Open3D as points: python open3d_points.py SCAN CAMERA.json PICTURE.png

Settings: https://www.open3d.org/docs/latest/tutorial/visualization/cpu_rendering.html (surfaceless EGL, Mesa),
open3d/examples/visualization/render_to_image.py (renderer), and the defaults of open3d.visualization.draw (3 pixels,
lit if there are normals).
"""

import json
import os
import sys

os.environ["EGL_PLATFORM"] = "surfaceless"
import open3d as o3d
from open3d.visualization import rendering

scan, camera, picture = sys.argv[1:]
with open(camera) as file:
    view = json.load(file)
cloud = o3d.io.read_point_cloud(scan)
material = rendering.MaterialRecord()
material.shader = "defaultLit" if cloud.has_normals() else "defaultUnlit"
material.point_size = 3
render = rendering.OffscreenRenderer(*view["size"])
render.scene.set_background([1, 1, 1, 1])
render.scene.add_geometry("scan", cloud, material)
render.setup_camera(view["fov"], view["target"], view["eye"], view["up"])
o3d.io.write_image(picture, render.render_to_image())
