"""Render a scan with PyVista as points with eye-dome lighting: python pyvista_edl.py SCAN CAMERA.json PICTURE.png

Settings: https://docs.pyvista.org/examples/02-plot/edl (a lidar cloud with point_size=5, the default).
"""

import json
import sys

import pyvista as pv

scan, camera, picture = sys.argv[1:]
with open(camera) as file:
    view = json.load(file)
cloud = pv.read(scan)
plotter = pv.Plotter(off_screen=True, window_size=view["size"])
plotter.set_background("white")
colors = {"scalars": "RGB", "rgb": True} if "RGB" in cloud.point_data else {}
plotter.add_mesh(cloud, point_size=5, **colors)
plotter.enable_eye_dome_lighting()
plotter.camera_position = view["eye"], view["target"], view["up"]
plotter.camera.view_angle = view["fov"]
plotter.screenshot(picture)
