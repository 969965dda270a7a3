"""Render a scan with Open3D as a Poisson mesh: python open3d_poisson.py SCAN CAMERA.json PICTURE.png

Settings: https://www.open3d.org/docs/latest/tutorial/geometry/surface_reconstruction.html (depth 9; the 1% of the
vertices with the lowest density are removed), light and renderer as in open3d_points.py. A new process draws the mesh:
in the one that made it the renderer often hangs (Open3D 0.20, Mesa 22.3.6).
"""

import json
import os
import sys

import numpy as np
import open3d as o3d
from open3d.visualization import rendering

scan, camera, picture = sys.argv[1:]
if not scan.endswith(".mesh.ply"):
    cloud = o3d.io.read_point_cloud(scan)
    mesh, densities = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=9)
    mesh.remove_vertices_by_mask(densities < np.quantile(densities, 0.01))
    mesh.compute_vertex_normals()
    scan = picture + ".mesh.ply"
    o3d.io.write_triangle_mesh(scan, mesh)
    os.execv(sys.executable, [sys.executable, sys.argv[0], scan, camera, picture])
with open(camera) as file:
    view = json.load(file)
mesh = o3d.io.read_triangle_mesh(scan)
material = rendering.MaterialRecord()
material.shader = "defaultLit"
render = rendering.OffscreenRenderer(*view["size"])
render.scene.set_background([1, 1, 1, 1])
render.scene.add_geometry("scan", mesh, material)
render.setup_camera(view["fov"], view["target"], view["eye"], view["up"])
o3d.io.write_image(picture, render.render_to_image())
