"""Render a scan with F3D as point sprites: python f3d_sprites.py SCAN CAMERA.json PICTURE.png

Settings: https://f3d.app/docs/user/OPTIONS (point sprites; circles, since spheres darken each other; component -2 shows
colours as they are; anti-aliasing). Sprites of the default size, 10, hide details of dense scans; 2 closes the gaps.
"""

import json
import sys

import f3d

scan, camera, picture = sys.argv[1:]
with open(camera) as file:
    view = json.load(file)
f3d.Engine.autoload_plugins()
engine = f3d.Engine.create(offscreen=True)
engine.options.update(
    {
        "model.point_sprites.enable": True,
        "model.point_sprites.type": "circle",
        "model.point_sprites.size": 2.0,
        "model.scivis.enable": True,
        "model.scivis.array_name": "RGB",
        "model.scivis.component": -2,
        "render.effect.antialiasing.enable": True,
        "render.background.color": [1.0, 1.0, 1.0],
    }
)
engine.scene.add(scan)
engine.window.size = tuple(view["size"])
eye = engine.window.camera
eye.position, eye.focal_point, eye.view_up, eye.view_angle = view["eye"], view["target"], view["up"], view["fov"]
engine.window.render_to_image().save(picture)
