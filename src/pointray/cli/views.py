"""The camera, as options or a scene file describe it."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

from ..base.choices import AUTO
from .options import numbers, size_of, up_axis


class View:
    """The camera that options describe, or one that sees the whole scan. A wrong option raises ValueError at once.

    Parameters
    ----------
    size, up : str
    lens : dict
        fov, projection, aperture and focus, as `Camera.look_at` takes them.
    **framing
        The options eye and target, or view, azimuth, elevation and zoom, which tell how to frame the scan.
    """

    def __init__(self, size: str, up: str = AUTO, lens: dict[str, Any] | None = None, **framing: Any) -> None:
        from ..auto_view.first_view import ViewChoice

        self.size = size_of(size)
        self.lens: dict[str, Any] = {"fov": 40.0, "projection": "perspective", "aperture": 0.0, "focus": None}
        self.lens |= lens or {}
        eye, target = framing.pop("eye", None), framing.pop("target", None)
        self.eye = None if eye is None else numbers(eye, "--eye")
        self.target = None if target is None else numbers(target, "--target")
        given_up = up_axis(up)
        self.choice = ViewChoice(given_up, **{name: value for name, value in framing.items() if value is not None})
        if not self.framed and self.choice != ViewChoice(given_up):
            raise ValueError(
                "--view, --azimuth, --elevation and --zoom are for a camera that frames the scan, without --eye"
            )
        if self.lens["focus"] is not None and not self.lens["aperture"]:
            raise ValueError("--focus is for --aperture, which is not given")
        near = self.eye or (0.0, 0.0, 0.0)
        probe = self.target or [x + 1 + abs(x) for x in near]
        self._look_at(near, probe, given_up or (0.0, 0.0, 1.0))

    @property
    def inputs(self) -> dict[str, Any]:
        """What the frames of a turntable depend on, besides the size, as values of JSON."""
        return {"eye": self.eye, "target": self.target, **asdict(self.choice), **self.lens}

    @property
    def up(self) -> Any:
        """The up direction for use before the scan is read; z if the scan is to tell."""
        return self.choice.up or (0.0, 0.0, 1.0)

    @property
    def framed(self) -> bool:
        """Whether the options leave the position of the camera to the scan."""
        return self.eye is None and self.target is None

    def camera(self, scan: Any) -> Any:
        """The camera for a `Scan`."""
        from ..auto_view.coverage import LEAST
        from ..base.warning_log import warn

        framed = scan.camera(self._framing_lens)
        if self.framed:
            return replace(framed, aperture=self.lens["aperture"], focus=self.lens["focus"])
        target = self.target or scan.middle
        # Without --eye, direction and distance are those that frame the scan.
        eye = self.eye or [e + a - t for e, a, t in zip(framed.eye, target, framed.target, strict=True)]
        camera = self._look_at(eye, target, scan.up)
        share = scan.coverage(camera)
        if share < LEAST:
            warn(f"the points cover {share:.1%} of the picture: without --eye and --target all are seen", stacklevel=2)
        return camera

    def turning(self, scan: Any) -> Any:
        """The first camera of a turntable for a `Scan`; unless options place it, the scan stays in all pictures.

        A panorama is not framed: `CameraPath` refuses a turntable for it, and keys do not use this camera.
        """
        if self.framed and self.lens["projection"] != "panorama":
            framed = scan.turning(self._framing_lens)
            return replace(framed, aperture=self.lens["aperture"], focus=self.lens["focus"])
        return self.camera(scan)

    @property
    def _framing_lens(self) -> Any:
        """The parts of the lens that framing needs."""
        from ..auto_view.framing import Lens

        return Lens(self.lens["fov"], self.size, self.lens["projection"])

    def _look_at(self, eye: Any, target: Any, up: Any) -> Any:
        from ..rendering.camera import Camera

        return Camera.look_at(eye, target, up, size=self.size, **self.lens)


class SceneView:
    """The camera of a scene file, with the attributes of `View` that films need.

    Parameters
    ----------
    values : dict
        Arguments of `Camera.look_at` or `Camera.frame`.
    """

    def __init__(self, values: dict[str, Any]) -> None:
        from ..scenefile.plan import BOX, camera_of

        camera = camera_of(values, BOX)  # only its eye and target depend on the bounds
        self.size, self.up = camera.size, camera.up
        self.lens = {name: getattr(camera, name) for name in ("fov", "projection", "aperture", "focus")}
        self.inputs = {"camera": values}
