"""Real notebook servers in a folder of their own, and views of the widget in their pages."""

import base64
import io
import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from contextlib import ExitStack, closing, contextmanager, suppress

import numpy as np
import pytest
from PIL import Image

from helpers.browser_page import BOX, FINISHED, SECONDS

SIZE = (1200, 2600)  # of the tab, so that all cells are visible: JupyterLab removes others
TOKEN = "secret"
PORTS = 3  # tried; another program may take one before the server does
NEWS = "@jupyterlab/apputils-extension/notification.jupyterlab-settings"


def free_port():
    with closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextmanager
def running(command, **options):
    """Run a command in a process group of its own; end all of the group afterwards."""
    process = subprocess.Popen(command, stderr=subprocess.STDOUT, start_new_session=True, **options)
    try:
        yield process
    finally:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(20)
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@contextmanager
def serving(folder, module, *arguments, path):
    """Run a module as a server in a folder, without the user's settings, at a free port, "{port}" in the arguments.

    Yields the server's address once a path of it answers.
    """
    home = folder / "home"
    home.mkdir(exist_ok=True)
    places = {name: str(home / name.lower()) for name in ("JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "IPYTHONDIR")}
    for place in places.values():
        os.makedirs(place, exist_ok=True)
    settings = home / "settings" / NEWS
    settings.parent.mkdir(parents=True, exist_ok=True)
    settings.write_text(json.dumps({"fetchNews": "false"}))
    config = home / "jupyter_config_dir" / "labconfig"  # other packages' extensions would ask for a build
    config.mkdir(exist_ok=True)
    (config / "page_config.json").write_text(json.dumps({"buildCheck": False, "buildAvailable": False}))
    places |= {"JUPYTER_RUNTIME_DIR": str(home / "runtime"), "JUPYTERLAB_SETTINGS_DIR": str(home / "settings")}
    environment = {**os.environ, **places, "XDG_CONFIG_HOME": str(home), "XDG_STATE_HOME": str(home)}
    with ExitStack() as left:
        log = left.enter_context((folder / "server.log").open("w"))
        for _ in range(PORTS):
            port = free_port()
            command = [sys.executable, "-m", module, *(argument.format(port=port) for argument in arguments)]
            process = left.enter_context(running(command, cwd=folder, env=environment, stdout=log))
            address = f"http://127.0.0.1:{port}"
            _wait(lambda process=process, check=f"{address}/{path}": process.poll() is not None or _answers(check))
            if process.poll() is None:
                break
        else:
            raise AssertionError((folder / "server.log").read_text())
        yield address


class JupyterLab:
    """A running JupyterLab.

    Attributes
    ----------
    folder : path
        Folder of its notebooks.
    """

    def __init__(self, folder, at):
        self.folder, self._at = folder, at

    def address(self, path):
        """The address of a path on the server."""
        return f"{self._at}/{path}?token={TOKEN}"

    def kernel(self, name):
        """The kernel of an open notebook."""
        with urllib.request.urlopen(self.address("api/sessions"), timeout=SECONDS) as reply:
            sessions = json.load(reply)
        (number,) = (session["kernel"]["id"] for session in sessions if session["path"] == name)
        return Kernel(self.folder / "home" / "runtime" / f"kernel-{number}.json")

    def stop_kernels(self):
        """Stop all kernels, which are not in the server's process group."""
        with urllib.request.urlopen(self.address("api/kernels"), timeout=SECONDS) as reply:
            numbers = [kernel["id"] for kernel in json.load(reply)]
        for number in numbers:
            request = urllib.request.Request(self.address(f"api/kernels/{number}"), method="DELETE")
            urllib.request.urlopen(request, timeout=SECONDS).close()


@contextmanager
def jupyter_lab(folder):
    """Run JupyterLab in a folder."""
    pytest.importorskip("jupyterlab", exc_type=ImportError)
    pytest.importorskip("anywidget", exc_type=ImportError)
    arguments = ["--ServerApp.port={port}", "--ServerApp.port_retries=0", f"--IdentityProvider.token={TOKEN}"]
    with serving(folder, "jupyterlab", "--no-browser", "--allow-root", *arguments, path="api") as at:
        lab = JupyterLab(folder, at)
        try:
            yield lab
        finally:
            lab.stop_kernels()


@contextmanager
def marimo(folder, mode, name):
    """Run `marimo run` or `marimo edit` for a notebook in a folder; yields the address of its page."""
    pytest.importorskip("marimo", exc_type=ImportError)
    pytest.importorskip("anywidget", exc_type=ImportError)
    settings = folder / "home" / "marimo" / "marimo.toml"
    settings.parent.mkdir(parents=True)
    settings.write_text("[runtime]\nauto_instantiate = true\n")  # run all cells when the page is opened
    arguments = [mode, "--headless", "--no-token", "--port={port}", name]
    with serving(folder, "marimo", *arguments, path="health") as at:
        yield at


def _answers(address):
    try:
        with urllib.request.urlopen(address, timeout=5):
            return True
    except urllib.error.HTTPError:
        return True
    except OSError:
        return False


def _wait(condition):
    end = time.monotonic() + SECONDS
    while not (found := condition()):
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.05)
    return found


class Kernel:
    """The kernel behind a page of JupyterLab, for questions to it."""

    def __init__(self, file):
        from jupyter_client import BlockingKernelClient

        self._client = BlockingKernelClient(connection_file=str(file))
        self._client.load_connection_file()
        self._client.start_channels()

    def value(self, expression):
        """The value of an expression that is valid as JSON."""
        code = {"value": f"__import__('json').dumps({expression})"}
        reply = self._client.execute("", user_expressions=code, reply=True, timeout=SECONDS)
        answer = reply["content"]["user_expressions"]["value"]
        assert answer["status"] == "ok", answer
        return json.loads(eval(answer["data"]["text/plain"]))  # a literal of a text

    def wait(self, expression):
        """Wait until an expression is true."""
        _wait(lambda: self.value(expression))

    def close(self):
        self._client.stop_channels()


class Cell:
    """The view of the widget in a cell: the nth one on the notebook's page, or in a part of it."""

    def __init__(self, tab, number=0, part=None):
        self._tab, self._box = tab, (part or tab).locator(".pointray-viewer").nth(number)

    @property
    def frame(self):
        return self._box.locator("iframe").element_handle().content_frame()

    def until(self, condition, argument=None):
        """Wait for a condition of the page in the frame, which the notebook may load again."""
        self._box.locator("iframe").wait_for()
        return self.frame.wait_for_function(condition, arg=argument, timeout=1e3 * SECONDS)

    def shows(self, samples=4, after=-1):
        """Wait for a finished picture with few samples, so that a test is fast; return its pixels."""
        self.until("window.pointray?.last")
        self.row("samples").locator("select").select_option(label=f"{samples}")
        self.until(FINISHED, [samples, after])
        assert self._box.locator("> div").count() == 0  # the picture that is shown before
        return self.picture()

    def changed(self, act, samples=4):
        """Wait for a finished picture after an action; return its pixels."""
        number = self.last["number"]
        act()
        self.until(FINISHED, [samples, number])
        return self.picture()

    def picture(self):
        """The contents of the canvas, (h, w, 3) levels."""
        url = self.frame.evaluate("document.getElementById('view').toDataURL()")
        return pixels_of(base64.b64decode(url.partition(",")[2]))

    def row(self, name):
        return self.frame.locator(f'[data-name="{name}"]')

    @property
    def last(self):
        return self.frame.evaluate("pointray.last")

    @property
    def camera(self):
        return self.frame.evaluate("pointray.camera()")

    def drag(self, dx=120, dy=20):
        """Drag the mouse in the picture."""
        self._drag(self.frame.locator("#view"), (0.3, 0.5), (dx, dy))

    def slide(self, name, share):
        """Drag a slider from its middle to a share of its width."""
        slider = self.row(name).locator(".lil-slider")
        slider.evaluate(BOX)  # scrolls to it
        self._drag(slider, (0.5, 0.5), ((share - 0.5) * slider.bounding_box()["width"], 0))

    def _drag(self, element, start, by):
        box = element.bounding_box()  # on the page of the notebook
        x, y = box["x"] + start[0] * box["width"], box["y"] + start[1] * box["height"]
        self._tab.mouse.move(x, y)
        self._tab.mouse.down()
        self._tab.mouse.move(x + by[0], y + by[1], steps=6)
        self._tab.mouse.up()


def pixels_of(file):
    """The picture in a file, (h, w, 3) levels."""
    return np.asarray(Image.open(io.BytesIO(file)).convert("RGB")).astype(int)
