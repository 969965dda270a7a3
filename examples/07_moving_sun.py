# python examples/07_moving_sun.py moving_sun.webp
#
# A film of a day: light is baked once and updated for each position of the sun, without tracing links again. A number
# of frames may follow the file.
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

import pointray as pr

POINTS = 100_000
SIZE = (320, 400)
SAMPLES = 4
FRAMES = int(sys.argv[2]) if len(sys.argv) > 2 else 36

scene = pr.Scene()
scene.background = "environment"
scene.add(pr.Model(pr.procedural("statue", POINTS)), material=pr.Diffuse((0.75, 0.72, 0.66)))
scene.add(pr.Plane(point=(0, 0, 0), normal=(0, 0, 1), color=(0.55, 0.5, 0.42)))
scene.add(pr.Plane(point=(-0.9, 0, 0), normal=(1, 0, 0), color=(0.7, 0.16, 0.1)))
sky = pr.EnvironmentLight(radiance=(0.12, 0.22, 0.5), horizon=(0.35, 0.42, 0.55), ground=(0.2, 0.18, 0.15))
scene.lights = [sky, pr.SunLight(direction=(-1, 0.3, -1), irradiance=(3.0, 2.7, 2.2), angle=1.0)]
camera = pr.Camera.frame(scene.models[0].bounds, direction=(0.4, -1.0, 0.15), fov=30, size=SIZE)
scene.baked = pr.bake(scene)

frames = []
with tempfile.TemporaryDirectory() as folder:
    for k, angle in enumerate(np.radians(np.linspace(10, 85, FRAMES))):
        direction = -np.cos(angle), 0.5, -np.sin(angle)
        warmth = np.sin(angle)
        scene.lights = [sky, pr.SunLight(direction, (3.2, 1.6 + 1.3 * warmth, 0.7 + 1.8 * warmth), angle=1.0)]
        scene.baked.update()
        picture, image = Path(folder) / f"{k}.png", pr.render(scene, camera, pr.Settings("baked", spp=SAMPLES))
        pr.write_image(picture, image, exposure=-0.7, curve="filmic")
        frames.append(Image.open(picture).convert("RGB"))
        print(f"frame {k + 1} of {FRAMES}", end="\r", flush=True)
frames[0].save(sys.argv[1], save_all=True, append_images=frames[1:], duration=1000 // 12, loop=0, quality=90)
