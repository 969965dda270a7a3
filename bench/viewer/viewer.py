"""Measure the viewer's speed: in Debian's chromium while the mouse drags, of the server alone, and when it opens.

    python -m bench.viewer.viewer [--points 1000000] [--size 1280x720] [--seconds 6] [--runs 3] [--scan FILE] [--sun]
                           [--only page|server|opening] [--json FILE]

The scene is a statue in the default look, when its light is baked, or under a sun with shadows. "page" drags with real
mouse moves, 60 a second; it counts frames drawn, the time from a mouse move's camera message to its picture, the time
from the last move to a picture of all pixels, the sizes of moving pictures, bytes, and processor seconds a frame of
each process; "bench" is the one that moves the mouse. "server" sends the same cameras from a client that only
acknowledges. Chromium composites on the CPU, as it does on a computer without a graphics card.
"opening" measures the time from the command `pointray view` with the statue or another scan to the first and to the
full picture, with all kernels compiled and on a first start without any. Each figure is the median of the runs, with
minimum and maximum.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import shutil
import signal
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from playwright.sync_api import Page, sync_playwright
from websockets.sync.client import ClientConnection, connect

import pointray as pr

PROGRAM = "from pointray.cli import main; main()"
SUN = "sun:1,1,-1.5:3"
RATE = 60.0  # mouse moves and cameras a second
WARM = 3.0  # seconds of moving that are not counted, in which the pace finds its scale
BAKED = 120.0  # seconds within which light is baked
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
# Runs before the page's own code: notes what its socket receives, when pictures are shown, and the last mouse move.
LISTEN = """
window.taken = { bytes: 0, frames: [], shown: [], moved: 0, bakes: false };
const { transferFromImageBitmap } = ImageBitmapRenderingContext.prototype;
ImageBitmapRenderingContext.prototype.transferFromImageBitmap = function (bitmap) {
    taken.shown.push([performance.now(), bitmap.width]);
    transferFromImageBitmap.call(this, bitmap);
};
addEventListener("pointermove", () => (taken.moved = performance.now()), true);
window.WebSocket = class extends WebSocket {
    constructor(...words) {
        super(...words);
        this.addEventListener("message", ({ data }) => {
            taken.bytes += data.byteLength ?? data.length;
            if (typeof data === "string") {
                const { type, stage } = JSON.parse(data);
                if (type === "progress") taken.bakes = stage !== "";
                return;
            }
            const text = new Uint8Array(data, 4, new DataView(data).getUint32(0, true));
            const { stage, width, height } = JSON.parse(new TextDecoder().decode(text));
            taken.frames.push(`${stage} ${width}x${height}`);
        });
    }
};
"""
Figures = dict[str, Any]


@contextmanager
def serving(
    file: Path, *options: str, cache: str | None = None, light: str | None = None
) -> Iterator[tuple[psutil.Process, str]]:
    """`pointray view` of a file: the process and its address.

    cache : folder of kernels, or None for the usual one; light : instead of the default look
    """
    environment = {**os.environ, **({"POINTRAY_CACHE": cache} if cache else {})}
    words = [
        sys.executable,
        "-c",
        PROGRAM,
        "view",
        str(file),
        "--no-open",
        *(["--light", light] if light else []),
        *options,
    ]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stderr is not None
        lines = iter(process.stderr.readline, "")
        found = next((found for line in lines if (found := re.search(r"http://\S+/", line))), None)
        assert found is not None, "no address"
        try:
            yield psutil.Process(process.pid), found.group()
        finally:
            process.send_signal(signal.SIGINT)


def seconds_of(server: psutil.Process) -> Counter[str]:
    """Processor seconds so far of the server, each kind of browser process, and this process, which moves the mouse."""
    spent: Counter[str] = Counter(server=_seconds(server), bench=_seconds(psutil.Process()))
    for process in psutil.Process().children(recursive=True):
        if process == server:
            continue
        words = " ".join(process.cmdline())
        kind = re.search(r"--type=([\w-]+)", words)
        spent[kind[1] if kind else "browser" if "chromium" in words else "bench"] += _seconds(process)
    return spent


def _seconds(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def drag(page: Page, size: tuple[int, int], seconds: float) -> int:
    """Move the mouse on a loop around the middle with the button held; returns the number of moves."""
    begun, moves = time.perf_counter(), 0
    while (now := time.perf_counter() - begun) < seconds:
        pointer = 0.4 + 0.15 * math.sin(0.9 * now), 0.5 + 0.15 * math.cos(0.7 * now)
        page.mouse.move(pointer[0] * size[0], pointer[1] * size[1])
        moves += 1
        time.sleep(max(0.0, moves / RATE - (time.perf_counter() - begun)))
    return moves


def measure_page(page: Page, server: psutil.Process, size: tuple[int, int], seconds: float) -> Figures:
    """Figures of one drag."""
    page.mouse.move(0.4 * size[0], 0.5 * size[1])
    page.mouse.down()
    drag(page, size, WARM)
    page.evaluate("pointray.latency.length = 0, taken.bytes = 0, taken.frames = [], taken.shown = []")
    drawn, spent, begun = page.evaluate("pointray.frames"), seconds_of(server), time.perf_counter()
    moves = drag(page, size, seconds)
    passed = time.perf_counter() - begun
    drawn = page.evaluate("pointray.frames") - drawn
    spent = seconds_of(server) - spent
    latency, taken = page.evaluate("[pointray.latency, taken]")
    time.sleep(WARM)
    moved, shown = page.evaluate("[taken.moved, taken.shown]")
    page.mouse.up()
    kinds = Counter(taken["frames"])
    return {
        "fps": drawn / passed,
        "ms_to_all_pixels": next(at for at, width in shown if at > moved and width == size[0]) - moved,
        "latency_ms": statistics.median(latency),
        "latency_p95_ms": float(np.quantile(latency, 0.95)),
        "mib_per_s": taken["bytes"] / passed / 2**20,
        "mouse_per_s": moves / passed,
        "share": {kind: count / kinds.total() for kind, count in kinds.most_common()},
        "cpu_ms_per_frame": {kind: 1e3 * s / drawn for kind, s in spent.most_common()},
    }


def measure_pages(file: Path, size: tuple[int, int], seconds: float, runs: int, light: str | None) -> list[Figures]:
    """Drags in a browser that stays open, after light is baked."""
    with serving(file, light=light) as (server, url), sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        page = browser.new_page(bypass_csp=True, viewport={"width": size[0], "height": size[1]})
        page.add_init_script(LISTEN)
        page.goto(url)
        page.wait_for_function("pointray.last?.stage === 'refined' && !taken.bakes", timeout=1e3 * BAKED)
        page.wait_for_timeout(1e3 * WARM)  # baking may begin only now
        page.wait_for_function("pointray.last?.stage === 'refined' && !taken.bakes", timeout=1e3 * BAKED)
        rows = [measure_page(page, server, size, seconds) for _ in range(runs)]
        browser.close()
    return rows


def unpack(message: bytes) -> dict[str, Any]:
    """The header of a binary message."""
    length = struct.unpack("<I", message[:4])[0]
    header: dict[str, Any] = json.loads(message[4 : 4 + length])
    return header


def send(link: ClientConnection, kind: str, **words: Any) -> None:
    """Send a message as the page would."""
    link.send(json.dumps({"type": kind, **words}))


@contextmanager
def linked(url: str, size: tuple[int, int]) -> Iterator[ClientConnection]:
    """A client instead of a page."""
    with connect(f"ws{url.removeprefix('http')}socket", max_size=None) as link:
        send(link, "size", width=size[0], height=size[1])
        yield link


def orbit(link: ClientConnection, camera: dict[str, Any], seconds: float) -> tuple[int, list[float], Counter[str]]:
    """Send cameras, acknowledge pictures: bytes, milliseconds from camera to picture, pictures by kind."""
    target, away = np.array(camera["target"]), np.subtract(camera["eye"], camera["target"])
    size, latency, kinds, timed = 0, [], Counter[str](), 0.0
    begun, sent = time.perf_counter(), 0
    while (now := time.perf_counter() - begun) < seconds:
        if sent <= now * RATE:
            c, s = math.cos(0.6 * now), math.sin(0.6 * now)
            eye = target + (c * away[0] - s * away[1], s * away[0] + c * away[1], away[2])
            view = {"eye": eye.tolist(), "target": camera["target"], "up": camera["up"], "fov": camera["fov"]}
            send(link, "camera", **view, time=1e3 * time.perf_counter())
            sent += 1
        try:
            message = link.recv(timeout=max(0.0, sent / RATE - (time.perf_counter() - begun)))
        except TimeoutError:
            continue
        size += len(message)
        if isinstance(message, bytes):
            header = unpack(message)
            send(link, "seen", number=header["number"])
            kinds[f"{header['stage']} {header['width']}x{header['height']}"] += 1
            if header["time"] > timed:
                timed = header["time"]
                latency.append(1e3 * time.perf_counter() - timed)
    return size, latency, kinds


def wait_for_light(link: ClientConnection) -> dict[str, Any]:
    """Acknowledge pictures until nothing has been loaded, built or baked for WARM seconds; return the camera."""
    camera, busy, quiet = {}, True, time.perf_counter()
    while busy or time.perf_counter() - quiet < WARM:
        try:
            message = link.recv(timeout=WARM)
        except TimeoutError:
            continue
        if isinstance(message, bytes):
            send(link, "seen", number=unpack(message)["number"])
            continue
        message = json.loads(message)
        if message["type"] == "camera":
            camera = message
            send(link, "camera", **{name: message[name] for name in ("eye", "target", "up", "fov")}, time=0)
        elif message["type"] == "progress":
            busy, quiet = message["stage"] != "", time.perf_counter()
    return camera


def measure_server(file: Path, size: tuple[int, int], seconds: float, runs: int, light: str | None) -> list[Figures]:
    """Figures of a client that only acknowledges, after light is baked."""
    rows = []
    with serving(file, light=light) as (server, url), linked(url, size) as link:
        camera = wait_for_light(link)
        for _ in range(runs):
            orbit(link, camera, WARM)
            spent, begun = seconds_of(server), time.perf_counter()
            taken, latency, kinds = orbit(link, camera, seconds)
            passed, spent = time.perf_counter() - begun, seconds_of(server) - spent
            count = kinds.total()
            rows.append(
                {
                    "fps": count / passed,
                    "latency_ms": statistics.median(latency),
                    "latency_p95_ms": float(np.quantile(latency, 0.95)),
                    "mib_per_s": taken / passed / 2**20,
                    "share": {kind: n / count for kind, n in kinds.most_common()},
                    "cpu_ms_per_frame": {kind: 1e3 * s / count for kind, s in spent.most_common()},
                }
            )
    return rows


def measure_opening(
    file: Path, size: tuple[int, int], points: int, cache: str | None = None, options: tuple[str, ...] = ()
) -> Figures:
    """Seconds of each event from the command to the picture of all points."""
    begun, events, picture, stage = time.perf_counter(), {}, 0.0, ""

    def note(name: str, at: float | None = None) -> None:
        events.setdefault(name, time.perf_counter() - begun if at is None else at)

    with serving(file, *options, cache=cache, light=SUN) as (_, url):
        note("the address")
        with linked(url, size) as link:
            while True:
                message = link.recv()
                if isinstance(message, bytes):
                    picture = time.perf_counter() - begun
                    note("the first picture", picture)
                    send(link, "seen", number=unpack(message)["number"])
                    continue
                message = json.loads(message)
                if message["type"] == "camera":
                    send(link, "camera", **{name: message[name] for name in ("eye", "target", "up", "fov")}, time=0)
                elif message["type"] == "progress" and (word := message["stage"].split(":")[0]) and word != stage:
                    note(stage := word)
                elif message["type"] == "toast":
                    raise RuntimeError(message["text"])
                elif message["type"] == "status" and message["lines"][0].startswith("a sketch"):
                    note("a sketch", picture)
                elif message["type"] == "status" and f"{points:,} points" in message["lines"][2]:
                    note("the full picture", picture)  # the picture that the status describes came just before it
                    return {"s": dict(sorted(events.items(), key=lambda event: event[1]))}


def measure_first_opening(file: Path, size: tuple[int, int], points: int) -> Figures:
    """Like `measure_opening`, with no kernel compiled yet."""
    with tempfile.TemporaryDirectory(prefix="pointray-") as cache:
        return measure_opening(file, size, points, cache)


def summary(rows: list[Figures]) -> Figures:
    """Medians of all numbers, with the least and the greatest. Tables are summed up entry by entry."""
    out: Figures = {}
    for name in dict.fromkeys(name for row in rows for name in row):
        values = [row.get(name, 0.0) for row in rows]
        tables = [value for value in values if isinstance(value, dict)]
        out[name] = summary(tables) if tables else [statistics.median(values), min(values), max(values)]
    return out


def show(title: str, figures: Figures, indent: str = "  ") -> None:
    """Print a line for each figure."""
    print(title)
    for name, value in figures.items():
        if isinstance(value, dict):
            show(f"{indent}{name}", value, indent + "  ")
        else:
            print(f"{indent}{name:24s}{value[0]:9.2f}   ({value[1]:.2f} to {value[2]:.2f})")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--scan", type=Path, help="open this .ply instead of the statue")
    parser.add_argument("--sun", action="store_true", help="a sun with shadows instead of the default look")
    parser.add_argument("--only", choices=("page", "server", "opening"))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    arguments = (width, height), options.seconds, options.runs, SUN if options.sun else None
    with tempfile.TemporaryDirectory(prefix="pointray-") as folder:
        scan = options.scan or Path(folder, "statue.ply")
        if options.scan is None:
            pr.write(scan, pr.procedural("statue", options.points))
        opened = scan, arguments[0], len(pr.read(scan))
        works = {
            "page": lambda: measure_pages(scan, *arguments),
            "server": lambda: measure_server(scan, *arguments),
            "opening": lambda: [measure_opening(*opened) for _ in range(options.runs)],
            "opening for the first time": lambda: [measure_first_opening(*opened) for _ in range(options.runs)],
        }
        if options.only in (None, "opening"):
            measure_opening(*opened)  # its kernels may have to be compiled
        found = {name: summary(work()) for name, work in works.items() if name.startswith(options.only or "")}
    for name, figures in found.items():
        show(name, figures)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
