"""Render a scan with Open3D as a Poisson mesh: python open3d_poisson.py SCAN CAMERA.json PICTURE.png

Settings: https://www.open3d.org/docs/latest/tutorial/geometry/surface_reconstruction.html (depth 9; the 1% of the
vertices with the lowest density are removed), light and renderer as in open3d_points.py.
"""

import json
import sys

import numpy as np
import open3d as o3d
from open3d.visualization import rendering

scan, camera, picture = sys.argv[1:]
with open(camera) as file:
    view = json.load(file)
cloud = o3d.io.read_point_cloud(scan)
mesh, densities = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=9)
mesh.remove_vertices_by_mask(densities < np.quantile(densities, 0.01))
mesh.compute_vertex_normals()
material = rendering.MaterialRecord()
material.shader = "defaultLit"
render = rendering.OffscreenRenderer(*view["size"])
render.scene.set_background([1, 1, 1, 1])
render.scene.add_geometry("scan", mesh, material)
render.setup_camera(view["fov"], view["target"], view["eye"], view["up"])
o3d.io.write_image(picture, render.render_to_image())
