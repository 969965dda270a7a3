# python examples/06_statue.py statue.png
#
# 01_statue.toml in Python, with the same parameters and the same picture.
import sys

import pointray as pr

POINTS = 300_000
SIZE = (480, 600)
SAMPLES = 64

scene = pr.Scene()
scene.background = "environment"
scene.add(pr.Model(pr.procedural("statue", POINTS)), material=pr.Diffuse())
scene.add(pr.Plane(point=(0, 0, 0), normal=(0, 0, 1), color=(0.30, 0.26, 0.20)))
scene.add_light(pr.SunLight(direction=(1.0, 0.9, -1.1), irradiance=(3.4, 3.1, 2.6), angle=2.0))
scene.add_light(pr.EnvironmentLight(radiance=(0.15, 0.32, 0.8), horizon=(0.45, 0.62, 0.9), ground=(0.25, 0.23, 0.2)))
camera = pr.Camera.frame(scene.bounds, direction=(-0.35, -1.0, 0.12), fov=30, size=SIZE)
image = pr.render(scene, camera, pr.Settings(integrator="path", spp=SAMPLES))
pr.write_image(sys.argv[1], image, exposure=-0.9, curve="filmic")
