"""`pointray view` with many users leaks no memory or threads and reports no error."""

import random
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import contextmanager

import numpy as np
import psutil
import pytest

import pointray as pr
from helpers.browser_page import Page, chromium
from helpers.viewer_client import Browser

EVENTS = 1_200
BY_HAND = 120  # events in a real browser, which is killed after half of them
WARM = 1_000  # events before memory is measured: until then it grows to what so many users need
VISITORS = 3  # users without a page
GROWTH = 1.05  # some 10 kB an event: a scene, picture or session that is kept is more
SECONDS = 300.0  # for anything to happen: it only bounds a hang
SIZES = ((160, 120), (200, 100), (96, 128))
LEAST, MOST = 1, 3  # lights
PROGRAM = "from pointray.cli import main; main()"
INTEGRATORS = ("phong", "ao", "path", "normal", "depth", "color", "cost")
MATERIALS = ("own", "diffuse", "phong", "principled", "mirror", "glass")


@contextmanager
def serving(model, log):
    """`pointray view` of a saved model: the process, and the address of its page."""
    with log.open("w") as stream:
        words = [sys.executable, "-c", PROGRAM, "view", model, "--no-open"]
        process = subprocess.Popen(words, stderr=stream)
    try:
        yield psutil.Process(process.pid), wait(lambda: re.search(r"(http://\S+/) ", log.read_text()))[1]
        process.send_signal(signal.SIGINT)
        process.wait(SECONDS)
    finally:
        process.kill()
        process.wait()


def wait(condition, tell=lambda: "it never happened"):
    """Wait until a condition holds; returns its value."""
    end = time.monotonic() + SECONDS
    while not (found := condition()):
        assert time.monotonic() < end, tell()
        time.sleep(0.02)
    return found


class Visitor:
    """A user without a page, who acts at random."""

    ACTS = {
        "turn": 60,
        "set": 14,
        "sun": 8,
        "pick": 7,
        "size": 2,
        "view": 2,
        "lamp": 2,
        "press": 1,
        "come": 3,
        "send_invalid": 1,
    }

    def __init__(self, url, dice):
        self.url, self.dice = url, dice
        self.come()

    def come(self):
        """Connect, or leave and connect again."""
        self.leave()
        self.socket = Browser(self.url, self.dice.choice(SIZES))
        self.camera = self.socket.arrive()
        self.socket.listen(lambda: self.socket.controls().get("samples"))
        for name, value in (("samples", 4), ("output.width", 64), ("output.height", 48), ("output.samples", 1)):
            self.socket.set(name, value)

    def leave(self):
        if hasattr(self, "socket"):
            self.socket.close()

    def act(self):
        """Make one event and return its name."""
        (name,) = self.dice.choices(list(self.ACTS), self.ACTS.values())
        getattr(self, name)()
        self.socket.answer(0.002)
        return name

    def turn(self):
        """A step of a drag."""
        angle = self.dice.uniform(-0.2, 0.2)
        c, s = np.cos(angle), np.sin(angle)
        target = np.array(self.camera["target"])
        x, y, z = np.array(self.camera["eye"]) - target
        eye = target + np.array([c * x - s * y, s * x + c * y, z]) * self.dice.uniform(0.97, 1.03)
        self.camera = {**self.camera, "eye": eye.tolist()}
        self.socket.go(self.camera)

    def set(self):
        """Set a control of the panel, rarely one that rebuilds the model."""
        hidden = ("samples", "output.", "" if self.dice.random() < 0.03 else "build.")
        controls = [c for name, c in self.socket.controls().items() if not name.startswith(tuple(filter(None, hidden)))]
        control = self.dice.choice([c for c in controls if c["kind"] in ("choice", "range", "switch", "color")])
        self.socket.set(control["name"], self.value(control))

    def value(self, control):
        """A value that a control may have."""
        if control["kind"] == "choice":
            return self.dice.choice(control["options"])[0]
        if control["kind"] == "switch":
            return self.dice.random() < 0.5
        if control["kind"] == "color":
            return [self.dice.random() for _ in range(3)]
        value = self.dice.uniform(control["min"], control["max"])
        return round(value) if isinstance(control["value"], int) else value

    def sun(self):
        self.socket.say(type="sun", dx=self.dice.uniform(-0.1, 0.1), dy=self.dice.uniform(-0.1, 0.1))

    def pick(self):
        purpose = self.dice.choice(("query", "target"))
        click = {"x": self.dice.random(), "y": self.dice.random(), "extend": self.dice.random() < 0.5}
        self.socket.say(type="pick", purpose=purpose, **click)

    def size(self):
        width, height = self.dice.choice(SIZES)
        self.socket.say(type="size", width=width, height=height)

    def view(self):
        self.socket.say(type="view", name=self.dice.choice(("home", "front", "top", "left")))

    def lamp(self):
        """Add or remove a light."""
        lamps = [name for name in self.socket.controls() if re.fullmatch(r"lamps\.\d+\.remove", name)]
        more = len(lamps) < MOST and (len(lamps) <= LEAST or self.dice.random() < 0.5)
        self.socket.say(type="press", name="lamps.add.sun" if more else self.dice.choice(lamps))

    def press(self):
        self.socket.say(
            type="press", name=self.dice.choice(("copy.command", "copy.python", "save.stop", "save.picture"))
        )

    def send_invalid(self):
        self.socket.say_text(
            self.dice.choice(("{", "null", '{"type": "camera"}', '{"type": "set", "name": "lamps.9.on"}'))
        )

    def try_all(self):
        """Use everything that loads machine code, which stays in memory and is not a leak."""
        for k in range(max(len(INTEGRATORS), len(MATERIALS))):
            self.socket.set("integrator", INTEGRATORS[k % len(INTEGRATORS)])
            self.socket.set("material", MATERIALS[k % len(MATERIALS)])
            self.turn()
            self.socket.refined(4)
            self.socket.answer(0.002)


class Hand:
    """A user with a real browser."""

    def __init__(self, launch, url, dice):
        self.dice = dice
        self.browser = launch()
        self.page = Page(self.browser, url, (480, 270))
        self.page.until("pointray.last")

    def act(self):
        """Make some events and return their number."""
        steps = self.dice.randint(5, 12)
        choice = self.dice.random()
        if choice < 0.6:
            self.page.drag((120, 130), (self.dice.uniform(-80, 80), self.dice.uniform(-80, 80)), steps)
        elif choice < 0.8:
            self.page.slide("exposure", self.dice.random())
            steps = 8
        else:
            self.page.tab.keyboard.press(self.dice.choice("123456h"))
            steps = 1
        return steps

    def killed(self):
        """Kill the browser by signal 9, without a message to the server."""
        started = [p for p in psutil.Process().children(recursive=True) if p.name() == "chromium"]
        (main,) = [p for p in started if not any(word.startswith("--type=") for word in p.cmdline())]
        main.send_signal(signal.SIGKILL)
        main.wait(SECONDS)

    def leave(self):
        assert self.page.problems == []
        self.browser.close()


def resources_without_users(server):
    """Return memory and threads of the server after all users have left."""
    before = []

    def calm():
        before.append((server.num_threads(), server.memory_info().rss))
        return len(before) > 50 and len(set(before[-50:])) == 1

    wait(calm)
    return before[-1]


@pytest.mark.long
def test_a_thousand_events(tmp_path):
    """Memory and threads return to their previous values, even after a browser was killed."""
    pr.Model(pr.procedural("statue", 5_000)).save(tmp_path / "statue.pointray")
    dice, done, log = random.Random(7), Counter(), tmp_path / "stderr"
    with chromium() as launch, serving(tmp_path / "statue.pointray", log) as (server, url):

        def make_events(count, hands):
            """Make this many events, some of them in a real browser."""
            visitors = [Visitor(url, dice) for _ in range(VISITORS)]
            hand, before = Hand(launch, url, dice), done["hand"]
            for k in range(count - hands):
                done[visitors[k % VISITORS].act()] += 1
                while (done["hand"] - before) * (count - hands) < hands * (k + 1):
                    done["hand"] += hand.act()
            for visitor in visitors:
                visitor.leave()
            return hand

        visitor = Visitor(url, dice)
        visitor.try_all()
        visitor.leave()
        make_events(WARM, BY_HAND // 2).leave()
        threads, memory = resources_without_users(server)
        done.clear()
        make_events(EVENTS // 2, BY_HAND // 2).killed()
        make_events(EVENTS // 2, BY_HAND // 2).leave()
        print(f"{threads} threads, {memory:,} bytes; {sum(done.values())} events: {dict(done)}")
        assert sum(done.values()) >= EVENTS and done["hand"] >= BY_HAND
        wait(
            lambda: server.num_threads() <= threads and server.memory_info().rss <= GROWTH * memory,
            lambda: f"now {server.num_threads()} threads, {server.memory_info().rss:,} bytes",
        )
    expected = "ignored a message of the page: ", "pointray: note: the scene has no light: "  # random events
    output = [line for line in log.read_text().splitlines() if not line.startswith(expected)]
    assert len(output) == 2, output  # the address, and how the scan is seen
