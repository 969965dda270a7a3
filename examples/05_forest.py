# python examples/05_forest.py forest.png
#
# A thousand instances of a fir. Its points are generated here; any NumPy arrays will do.
import sys

import numpy as np

import pointray as pr

POINTS = 60_000
TREES = 1_000
SIZE = (800, 450)

rng = np.random.default_rng(7)


def cone(count, base, tip, radius, color):
    """Points of a cone about z, with normals and colours."""
    down = np.sqrt(rng.uniform(0.002, 1, count))[:, None]  # 0 at the tip; its area grows with it
    angle = rng.random(count)[:, None] * 2 * np.pi
    around = np.concatenate([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    positions = around * radius * down + [0, 0, 1] * (tip - (tip - base) * down)
    normals = around * (tip - base) + np.array([0, 0, radius])
    shade = rng.uniform(0.85, 1.15, (count, 1)) * color
    return positions, normals / np.linalg.norm(normals, axis=1, keepdims=True), np.clip(shade, 0, 1)


green, brown = np.array([0.28, 0.38, 0.24]), np.array([0.34, 0.26, 0.20])
parts = [
    cone(POINTS // 10, 0.0, 2.0, 0.14, brown),
    cone(POINTS * 4 // 10, 0.5, 1.9, 0.85, green),
    cone(POINTS * 3 // 10, 1.2, 2.5, 0.65, green * 1.1),
    cone(POINTS * 2 // 10, 1.9, 3.1, 0.42, green * 1.2),
]
positions, normals, colors = (np.concatenate(rows) for rows in zip(*parts, strict=True))
fir = pr.Model(pr.Points(positions, normals, colors))

scene = pr.Scene()
for x, y in rng.uniform(-1, 1, (TREES, 2)) * [42, 34]:
    wide, high = rng.uniform(0.6, 1.5) * np.array([1.0, rng.uniform(0.9, 1.3)])
    scene.add(fir, pr.transform(translate=(x, y + 28, 0), rotate=rng.uniform(0, 360), scale=(wide, wide, high)))
scene.add(pr.Plane(point=(0, 0, 0), normal=(0, 0, 1), color=(0.17, 0.16, 0.08)))
scene.add_light(pr.SunLight(direction=(1.0, 0.5, -0.6), irradiance=(4.0, 3.1, 2.0), angle=1))
scene.add_light(pr.EnvironmentLight((0.12, 0.3, 0.8), horizon=(0.55, 0.65, 0.8)))
scene.background = "environment"

camera = pr.Camera.look_at(eye=(0, -14, 5.5), target=(0, 12, 1.2), fov=34, size=SIZE)
image = pr.render(scene, camera, pr.Settings("path", spp=32, max_depth=3))
pr.write_image(sys.argv[1], image, exposure=-0.7, curve="filmic")
