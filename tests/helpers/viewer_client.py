"""A viewer client for tests: it sends messages like the page, and keeps those it receives."""

import io
import json
import re
import struct
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager
from queue import SimpleQueue

import numpy as np
import pytest
from PIL import Image
from websockets.sync.client import connect

import pointray as pr
from pointray.cli import execute
from pointray.image.screen import to_8bit
from pointray.image.tone import GRADIENT, backdrop_rows
from pointray.viewer.messages import describe
from pointray.viewer.viewer import Viewer

SIZE = (160, 120)
SECONDS = 120.0  # for anything to happen: it only bounds a hang
CLOSE = 1.5  # of 255: the mean change that JPEG may make


def levels_in(file):
    """The picture in a file, (h, w, 3)."""
    return np.asarray(Image.open(io.BytesIO(file)).convert("RGB")).astype(int)


def expected(scene, camera, samples, size=SIZE, exposure=0.0, **settings):
    """The picture by `render`, over the viewer's backdrop."""
    view = pr.Camera.look_at(camera["eye"], camera["target"], camera["up"], camera["fov"], size)
    return shown_levels(pr.render(scene, view, pr.Settings(spp=samples, **settings)), exposure)


def shown_levels(image, exposure=0.0):
    """A picture over the viewer's backdrop."""
    return to_8bit(image, backdrop_rows(GRADIENT, len(image))[:, 0], exposure).astype(int)


def scene_of(model):
    """A model under a sun."""
    scene = pr.Scene()
    scene.add(model)
    scene.add_light(pr.SunLight([1, 1, -1.5], 3))
    return scene


def compile_kernels(scene):
    """Compile kernels before a test waits for a picture, as this may take minutes."""
    camera = describe(pr.Camera.frame(scene.bounds))
    for settings in ({}, {"integrator": "normal"}):
        expected(scene, camera, 2, (8, 8), **settings)


def socket_of(url):
    """The address of the socket of a viewer's page."""
    return f"ws{url.removeprefix('http')}socket"


class Browser:
    """Connects, acknowledges pictures, and waits for messages."""

    def __init__(self, url, size=SIZE, **headers):
        self._left = ExitStack()
        socket = connect(socket_of(url), max_size=None, **headers)
        self._socket = self._left.enter_context(socket)
        self.told, self.frames, self.files = [], [], []
        self.say(type="size", width=size[0], height=size[1])

    def say(self, **message):
        self._socket.send(json.dumps(message))

    def say_text(self, text):
        self._socket.send(text)

    def listen(self, until, seconds=SECONDS):
        """Receive messages until a condition holds, and return its value."""
        end = time.monotonic() + seconds
        while not (found := until()):
            left = end - time.monotonic()
            assert left > 0, f"nothing came; last: {[m.get('type') for m in self.told[-5:]]}"
            try:
                self._take(self._socket.recv(timeout=left))
            except TimeoutError:
                continue
        return found

    def rest(self, seconds):
        """Receive messages for some time."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                self._take(self._socket.recv(timeout=left))
            except TimeoutError:
                return

    def answer(self, seconds):
        """Like `rest`, but discard the messages."""
        self.rest(seconds)
        self.told = [m for m in (self.last("camera"), self.last("panel")) if m]
        self.frames.clear()

    def _take(self, message):
        if isinstance(message, str):
            self.told.append(json.loads(message))
            return
        length = struct.unpack("<I", message[:4])[0]
        header, payload = json.loads(message[4 : 4 + length]), message[4 + length :]
        if header["type"] == "file":
            self.files.append((header, payload))
            return
        self.frames.append((header, payload))
        self.say(type="seen", number=header["number"])

    def last(self, kind):
        """The newest message of a type, or None."""
        return next((m for m in reversed(self.told) if m["type"] == kind), None)

    def arrive(self):
        """Receive the camera from the server and return it."""
        camera = self.listen(lambda: self.last("camera"))
        self.go(camera)
        return camera

    def go(self, camera, **changes):
        view = {name: camera[name] for name in ("eye", "target", "up", "fov")}
        self.say(**{"type": "camera", **view, "time": 1.0, **changes})

    def refined(self, samples):
        """The next frame with this many samples."""
        begun = len(self.frames)
        return self.listen(lambda: next((f for f in self.frames[begun:] if f[0]["samples"] == samples), None))

    def shows(self, samples, wanted):
        """Wait for a frame with this many samples that equals a picture up to JPEG errors, and return True."""
        while True:
            levels = levels_in(self.refined(samples)[1])
            if levels.shape == wanted.shape and np.abs(levels - wanted).mean() < CLOSE:
                return True

    def set(self, name, value):
        self.say(type="set", name=name, value=value)

    def controls(self):
        """The controls of the panel by name."""
        return {c["name"]: c for folder in self.last("panel")["folders"] for c in folder["controls"]}

    def close(self):
        self._left.close()


@contextmanager
def view(*arguments):
    """Run `pointray view` in a thread of this process; yields the address of its page."""
    opened, whole = SimpleQueue(), Viewer.wait

    def wait(self, *until):
        opened.put(self)
        whole(self, *until)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Viewer, "wait", wait)
        patch.setattr("pointray.base.malloc_arenas.keep_one_heap", lambda: None)  # it would stay so in this process
        command = ["view", "--no-open", *map(str, arguments)]
        thread = threading.Thread(target=lambda: opened.put(f"exit status {execute(command)}"))
        thread.start()
        viewer = opened.get(timeout=SECONDS)
        assert isinstance(viewer, Viewer), viewer
        try:
            yield viewer.url
        finally:
            viewer.close()
            thread.join(SECONDS)


def serve(*arguments):
    """`pointray view` as a process; returns it, the address that it prints, and all that it has printed."""
    command = [sys.executable, "-m", "pointray.cli", "view", "--no-open", *map(str, arguments)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    output = []
    while not (found := re.search(r"http://\S+/", output[-1] if output else "")):
        output.append(process.stderr.readline())
        assert output[-1], output
    return process, found.group(), output
