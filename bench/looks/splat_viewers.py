"""Pictures of files of Gaussian splats by viewers of npm, in Debian's chromium with WebGL in software."""

from __future__ import annotations

import base64
import functools
import http.server
import io
import json
import shutil
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pointray.rendering.camera import Camera

CHROMIUM = "/usr/bin/chromium"
FLAGS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
FRAMES, WAIT = 8, 250  # frames that are drawn before the picture is taken, while splats are sorted, and ms between them
LONGEST = 300_000  # ms
MODULES = {
    "three": "three/build/three.module.js",
    "three/addons/": "three/examples/jsm/",
    "spark": "@sparkjsdev/spark/dist/spark.module.js",
    "gaussian-splats-3d": "@mkkellogg/gaussian-splats-3d/build/gaussian-splats-3d.module.js",
}
VIEWERS = {
    "spark": """
const {SplatMesh, SparkRenderer} = await import('spark');
const scene = new THREE.Scene(), mesh = new SplatMesh({url: given.url, extSplats: true});
scene.add(new SparkRenderer({renderer})); await mesh.initialized; scene.add(mesh);
draw = () => renderer.render(scene, camera);""",
    "gaussian-splats-3d": """
const {Viewer, SceneRevealMode} = await import('gaussian-splats-3d');
const viewer = new Viewer({selfDrivenMode: false, renderer, camera, useBuiltInControls: false,
  sharedMemoryForWorkers: false, gpuAcceleratedSort: false, sceneRevealMode: SceneRevealMode.Instant});
await viewer.addSplatScene(given.url, {showLoadingUI: false, splatAlphaRemovalThreshold: 1});
draw = () => { viewer.update(); viewer.render(); };""",
}
PAGE = """<!doctype html><body style="margin:0"><script type="importmap">{"imports": %s}</script>
<script type="module">
import * as THREE from 'three';
const given = JSON.parse(decodeURIComponent(location.hash.slice(1)));
const renderer = new THREE.WebGLRenderer({antialias: false, preserveDrawingBuffer: true});
renderer.setPixelRatio(1); renderer.setSize(...given.size); document.body.appendChild(renderer.domElement);
const camera = new THREE.PerspectiveCamera(given.fov, given.size[0] / given.size[1], given.near, given.far);
camera.position.set(...given.eye); camera.up.set(...given.up); camera.lookAt(...given.target);
camera.updateMatrixWorld();
const shots = [];
let draw;
try {
  %s
  for (const color of [0x000000, 0xffffff]) {
    renderer.setClearColor(color, 1);
    for (let k = 0; k < given.frames; k++) { draw(); await new Promise(done => setTimeout(done, given.wait)); }
    draw(); shots.push(renderer.domElement.toDataURL('image/png'));
  }
  window.result = shots;
} catch (error) { window.result = String(error.stack || error); }
</script></body>"""


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *words: object) -> None:
        """Print nothing."""


@contextmanager
def _served(folder: Path) -> Iterator[str]:
    """Serve a folder at the address that is yielded."""
    handler = functools.partial(_Quiet, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def open_in(viewer: str, modules: Path, file: Path, camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a viewer's picture of a file of splats, (h, w, 3) sRGB on black, and its alpha, (h, w).

    Alpha follows from pictures on black and on white.

    viewer : one of VIEWERS; modules : folder with node_modules, in which npm installed them
    """
    from playwright.sync_api import sync_playwright

    far = float(np.linalg.norm(np.subtract(camera.eye, camera.target)))
    given = {"url": f"/{file.name}", "size": camera.size, "fov": camera.fov, "near": far / 100, "far": far * 20}
    given |= {"eye": camera.eye, "up": camera.up, "target": camera.target, "frames": FRAMES, "wait": WAIT}
    imports = {name: f"/node_modules/{path}" for name, path in MODULES.items()}
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play:
        root = Path(folder)
        (root / "index.html").write_text(PAGE % (json.dumps(imports), VIEWERS[viewer]))
        (root / "node_modules").symlink_to((modules / "node_modules").resolve())
        shutil.copy(file, root)
        browser = play.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        with _served(root) as address:
            page = browser.new_page(viewport={"width": camera.size[0], "height": camera.size[1]})
            page.goto(f"{address}/index.html#{quote(json.dumps(given))}")
            page.wait_for_function("window.result !== undefined", timeout=LONGEST)
            shots = page.evaluate("window.result")
        browser.close()
    if isinstance(shots, str):
        raise RuntimeError(f"{viewer}: {shots}")
    black, white = (
        np.asarray(Image.open(io.BytesIO(base64.b64decode(shot.partition(",")[2]))).convert("RGB")) / 255
        for shot in shots
    )
    return black, 1 - (white - black).mean(axis=-1)
