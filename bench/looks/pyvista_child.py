"""Draw points with PyVista, eye-dome lighting on, spheres off; run by `scatter_sheets.py` with a Python that has it.

python -m bench.looks.pyvista_child JOB.npz OUT.png

JOB.npz holds positions (n, 3), eye, target, up (3,), fov (vertical, degrees), size (width, height), point_size
(pixels), and colors (n, 3) uint8, or none (0, 3).
"""

from __future__ import annotations

import sys

import numpy as np

HOW = "python -m venv /tmp/pv && /tmp/pv/bin/pip install pyvista, then --pyvista /tmp/pv/bin/python"


def main() -> int:
    try:
        import pyvista
    except ImportError:
        print(f"PyVista is not installed: {HOW}", file=sys.stderr)
        return 2
    job = np.load(sys.argv[1])
    plotter = pyvista.Plotter(off_screen=True, window_size=job["size"].tolist())
    plotter.set_background([0.62, 0.65, 0.69], top=[0.5, 0.53, 0.57])
    cloud = pyvista.PolyData(job["positions"])
    look = {"style": "points", "render_points_as_spheres": False, "lighting": False, "color": "lightgrey"}
    if len(job["colors"]):
        cloud["rgb"] = job["colors"]
        look |= {"scalars": "rgb", "rgb": True, "color": None}
    plotter.add_mesh(cloud, point_size=float(job["point_size"]), **look)
    plotter.enable_eye_dome_lighting()
    plotter.camera.position, plotter.camera.focal_point = job["eye"].tolist(), job["target"].tolist()
    plotter.camera.up, plotter.camera.view_angle = job["up"].tolist(), float(job["fov"])
    plotter.reset_camera_clipping_range()
    plotter.screenshot(sys.argv[2])
    return 0


if __name__ == "__main__":
    sys.exit(main())
