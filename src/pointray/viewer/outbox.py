"""Messages to a page, as defined by the protocol (`docs/viewer.md`)."""

from __future__ import annotations

import base64
import io
import json
import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from .. import __version__
from ..base.arrays import Doubles
from ..cloud.points import Points
from ..image.legend import draw_legend
from ..rendering.camera import Camera
from ..scene.scene import Scene
from ..shade.attributes import Attribute
from .connection import PageLink
from .controls import Folder
from .messages import describe, pack
from .painter import Frame
from .pick import Found
from .shared_scene import Progress
from .sketch import Sketch

STATUS_INTERVAL = 0.25  # seconds between two messages with statistics
LEGEND = (600, 220)  # pixels
REPEAT_INTERVAL = 2.0  # seconds in which the same toast is not repeated
# Folders before a file name: in an absolute path up to its last slash, with spaces; in a relative path without spaces.
FOLDERS = re.compile(r"""((?<![^\s'"(])([A-Za-z]:)?[/\\][^:'"\n]*|[^\s:'"]*)[/\\](?=[^\s/\\])""")


class Outbox:
    """Sends messages to the page of one browser, with one method for each type of message. Thread-safe.

    Parameters
    ----------
    link : PageLink
        Queue of messages to the browser.
    """

    def __init__(self, link: PageLink) -> None:
        self._link = link
        self._status_at = 0.0
        self._toasts: dict[str, float] = {}  # recent toasts and their times
        self._described: list[dict[str, Any]] = []

    @property
    def is_local(self) -> bool:
        """Whether the page is on this machine. If not, folders are removed from file names in texts."""
        return self._link.is_local

    def send_message(self, **message: Any) -> None:
        """Send a message with these fields as JSON; one of them is its "type"."""
        self._link.send(json.dumps(message))

    def hello(self, title: str) -> None:
        self.send_message(type="hello", title=title, version=__version__)

    def place(self, seen: Scene | Sketch, up: Sequence[float]) -> None:
        """Send the bounds, the up direction and the direction of north, for the page's navigation and north arrow.

        seen : the scene, or the sketch that replaces it while kernels are compiled
        """
        if isinstance(seen, Sketch):
            bounds, clouds = seen.points.bounds, [seen.points]
        else:
            bounds, clouds = seen.bounds, [model.points for model in seen.models]
        self.send_message(type="place", bounds=bounds.tolist(), up=list(up), north=north_of(clouds, up))

    def go(self, camera: Camera, animate: bool) -> None:
        """Move the page's camera. animate : whether it moves gradually"""
        self.send_message(type="camera", **describe(camera), animate=animate)

    def panel(self, folders: Sequence[Folder]) -> None:
        """Send the panel if it has changed: the page rebuilds it, which would interrupt the user."""
        described = [folder.describe() for folder in folders]
        if described != self._described:
            self._described = described
            self.send_message(type="panel", folders=described)

    def progress(self, progress: Progress) -> None:
        self.send_message(type="progress", stage=progress.stage, share=progress.share, seconds=progress.seconds)

    def toast(self, level: str, text: str, stay: bool = False) -> None:
        """Show a text on the page for a while, or permanently if `stay`; drop repetitions within 2 s.

        level : "info", "warning" or "error"
        """
        now = time.monotonic()
        self._toasts = {recent: at for recent, at in self._toasts.items() if now - at < REPEAT_INTERVAL}
        if not stay and text in self._toasts:
            return
        self._toasts[text] = now
        self.send_message(type="toast", level=level, text=text if self.is_local else FOLDERS.sub("", text), stay=stay)

    def found(self, found: Found, first: Doubles | None) -> None:
        """Send the surface point that the user has clicked, with its description.

        first : (3,), world position of the point clicked before, to which the distance is sent, too; None: no distance
        """
        position = found.position.tolist()
        self.send_message(type="picked", lines=found.lines, position=position, second=first is not None)
        if first is not None:
            difference = found.position - first
            parts = [f"d{axis} {part:.6g}" for axis, part in zip("xyz", difference.tolist(), strict=True)]
            measured = {
                "from": first.tolist(),
                "to": position,
                "text": f"{np.linalg.norm(difference):.6g}",
                "parts": parts,
            }
            self.send_message(**{"type": "measured", **measured})

    def legend(self, image: str | None) -> None:
        """Send the legend of the colours to the page. image : PNG as a data URL; None removes the legend"""
        self.send_message(type="legend", image=image)

    def file(self, path: Path, mime: str) -> None:
        """Send a file for the page to save; wait until it is sent or the page has disconnected. mime : media type"""
        self._link.send_file(pack({"type": "file", "name": path.name, "mime": mime}), path)

    def frame(self, frame: Frame, rate: float) -> None:
        """Send an image; also statistics as text, every quarter of a second and with a completely refined image.

        rate : images a second while the camera moves, for the statistics
        """
        width, height = frame.size
        header = {"number": frame.number, "camera": describe(frame.request.camera), "time": frame.request.time}
        header |= {"width": width, "height": height, "stage": frame.stage.name, "samples": frame.samples}
        self._link.send(pack({"type": "frame", **header, "mime": "image/jpeg"}, frame.jpeg))
        now = time.perf_counter()
        if now - self._status_at > STATUS_INTERVAL or frame.samples == frame.request.view.samples:
            self._status_at = now
            self.send_message(type="status", lines=_statistics(frame, rate))


def north_of(clouds: Sequence[Points], up: Sequence[float]) -> list[float] | None:
    """Return the direction of north, +y, for georeferenced points: coordinates far from zero and z up; else None."""
    far = any(points.origin.any() for points in clouds)
    return [0.0, 1.0, 0.0] if far and up[2] > 0.99 * float(np.linalg.norm(up)) else None


def legend_of(attribute: Attribute) -> str:
    """Return a picture of the colour scale of an attribute with its values: PNG as a data URL."""
    stream = io.BytesIO()
    Image.fromarray(draw_legend(np.zeros((*LEGEND, 4), np.uint8), attribute)).save(stream, "PNG")
    return f"data:image/png;base64,{base64.b64encode(stream.getvalue()).decode()}"


def _statistics(frame: Frame, rate: float) -> list[str]:
    sketch = frame.request.sketch
    if sketch is not None:
        return [f"preview: {len(sketch.points):,} of {sketch.count:,} points"]
    models = frame.request.scene.models
    points = sum(len(model.points) for model in models)
    held = sum(model.resident_bytes for model in models) / 2**20  # of a model in parts: its open parts
    what = f"{rate:.0f} fps"
    if frame.samples > 1:
        what = f"{frame.samples:,} of {frame.request.view.samples:,} samples"
    rays = frame.rays / max(frame.seconds, 1e-9) / 1e6
    return [
        f"{what}, {frame.size[0]}x{frame.size[1]}",
        f"{rays:.1f} million camera rays/s",
        f"{points:,} points, {held:,.0f} MiB",
    ]
