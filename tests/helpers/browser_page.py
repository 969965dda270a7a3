"""A page of the viewer in a real browser, driven like by a user. `viewer_client` does the same without a page."""

import base64
import io
import json
import shutil
import struct
import time
from contextlib import contextmanager

import numpy as np
import pytest
from PIL import Image

SECONDS = 120.0  # for anything to happen: it only bounds a hang
FLAGS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-background-networking")

# Whether the last picture is finished: it has this many samples, and the page's camera.
FINISHED = """([samples, number]) => {
    const { last } = pointray;
    const camera = pointray.camera();
    const same = (name) => JSON.stringify(last.camera[name]) === JSON.stringify(camera[name]);
    return last && camera && last.number > number && last.stage === "refined" && last.samples === samples
        && ["eye", "target", "up", "fov"].every(same);
}"""

# The position of an element, after a scroll to it.
BOX = "element => { element.scrollIntoView({ block: 'nearest' }); return element.getBoundingClientRect().toJSON(); }"


@contextmanager
def chromium():
    """A function that starts Debian's browser without a window; skips the test if there is none."""
    sync = pytest.importorskip("playwright.sync_api", reason="playwright is not here")
    program = shutil.which("chromium")
    if program is None:
        pytest.skip("chromium is not here")
    with sync.sync_playwright() as play:
        yield lambda: play.chromium.launch(executable_path=program, args=list(FLAGS))


class Page:
    """The viewer's page in a tab of its own.

    Attributes
    ----------
    tab : the page of playwright
    problems : list of str
        Errors on the console and requests that failed.
    said : list of str
        All messages that the page has sent.
    headers : list of dict
        Headers of all pictures that came.
    """

    def __init__(self, browser, url, size, **options):
        self.tab = browser.new_page(
            bypass_csp=True,  # for `wait_for_function`, which evaluates text
            viewport={"width": size[0], "height": size[1]},
            **options,
        )
        self.tab.set_default_timeout(1e3 * SECONDS)
        self.problems, self.said, self.headers = [], [], []
        self.tab.on("console", lambda m: m.type in ("error", "warning") and self.problems.append(m.text))
        self.tab.on("pageerror", lambda error: self.problems.append(str(error)))
        self.tab.on("requestfailed", lambda request: self.problems.append(f"{request.url} {request.failure}"))
        self.tab.on("response", lambda r: r.status >= 400 and self.problems.append(f"{r.url} {r.status}"))
        self.tab.on("websocket", self._on_socket)
        self.tab.goto(url)

    def _on_socket(self, socket):
        socket.on("framesent", lambda text: self.said.append(text))
        socket.on("framereceived", self._note)

    def _note(self, message):
        if isinstance(message, bytes):
            header = json.loads(message[4 : 4 + struct.unpack("<I", message[:4])[0]])
            if header["type"] == "frame":
                self.headers.append(header)

    def close(self):
        self.tab.close()

    def until(self, condition, argument=None):
        """Wait for a condition of the page."""
        return self.tab.wait_for_function(condition, arg=argument)

    def wait(self, condition):
        """Wait for a condition on the recorded messages, while receiving more."""
        end = time.monotonic() + SECONDS
        while not condition():
            assert time.monotonic() < end, "it never happened"
            self.tab.wait_for_timeout(10)

    @property
    def camera(self):
        return self.tab.evaluate("pointray.camera()")

    @property
    def last(self):
        """The header of the picture that is shown."""
        return self.tab.evaluate("pointray.last")

    @property
    def frames(self):
        return self.tab.evaluate("pointray.frames")

    def picture(self):
        """Return the contents of the canvas, (h, w, 3) levels."""
        url = self.tab.evaluate("document.getElementById('view').toDataURL()")
        image = Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2])))
        return np.asarray(image.convert("RGB")).astype(int)

    def finished(self, samples, after=-1):
        """Wait until the picture is finished, and return its header."""
        self.until(FINISHED, [samples, after])
        return self.last

    @contextmanager
    def another(self, samples):
        """Wait for a finished picture after the present one."""
        number = self.last["number"]
        yield
        self.finished(samples, number)

    def row(self, name):
        """A control's row in the panel."""
        return self.tab.locator(f'[data-name="{name}"]')

    def open_folder(self, title):
        self.tab.locator(".lil-title").get_by_text(title, exact=True).click()

    def choose(self, name, label):
        self.row(name).locator("select").select_option(label=label)

    def drag(self, start, by, steps=8, button="left"):
        """Drag the mouse, with the keys that are held."""
        self.tab.mouse.move(*start)
        self.tab.mouse.down(button=button)
        self.tab.mouse.move(start[0] + by[0], start[1] + by[1], steps=steps)
        self.tab.mouse.up(button=button)

    def slide(self, name, share):
        """Drag a slider from its middle to a share of its width."""
        box = self.row(name).locator(".lil-slider").evaluate(BOX)  # at once: the panel may be rebuilt at any time
        middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        self.drag(middle, ((share - 0.5) * box["width"], 0))

    def number(self, name):
        """The number in a field of the panel."""
        return float(self.row(name).locator("input").input_value())

    @contextmanager
    def holding(self, key):
        self.tab.keyboard.down(key)
        yield
        self.tab.keyboard.up(key)
