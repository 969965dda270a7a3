"""Where the camera is: as the options say, or as a scene file does."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

from ..choices import AUTO
from .options import numbers, size_of, up_axis


class View:
    """Where the camera is: where the options say, else where the whole scan is seen. Raises what is wrong at once.

    Parameters
    ----------
    size, up : str
    lens : fov, projection, aperture and focus, as `Camera.look_at` takes them
    place : the options eye and target, and view, azimuth, elevation and zoom, which say how the scan is framed
    """

    def __init__(self, size: str, up: str = AUTO, lens: dict[str, Any] | None = None, **place: Any) -> None:
        from ..staging.first_view import ViewChoice

        self.size = size_of(size)
        self.lens: dict[str, Any] = {"fov": 40.0, "projection": "perspective", "aperture": 0.0, "focus": None}
        self.lens |= lens or {}
        eye, target = place.pop("eye", None), place.pop("target", None)
        self.eye = None if eye is None else numbers(eye, "--eye")
        self.target = None if target is None else numbers(target, "--target")
        given_up = up_axis(up)
        self.choice = ViewChoice(given_up, **{name: value for name, value in place.items() if value is not None})
        if not self.framed and self.choice != ViewChoice(given_up):
            raise ValueError(
                "--view, --azimuth, --elevation and --zoom are for a camera that frames the scan, without --eye"
            )
        if self.lens["focus"] is not None and not self.lens["aperture"]:
            raise ValueError("--focus is for --aperture, which is not given")
        near = self.eye or (0.0, 0.0, 0.0)
        probe = self.target or [x + 1 + abs(x) for x in near]
        self._looking(near, probe, given_up or (0.0, 0.0, 1.0))

    @property
    def settings(self) -> dict[str, Any]:
        """What a turntable's frames depend on, as JSON takes it; the size apart."""
        return {"eye": self.eye, "target": self.target, **asdict(self.choice), **self.lens}

    @property
    def up(self) -> Any:
        """Which way is up, for who asks before the scan is read."""
        return self.choice.up or (0.0, 0.0, 1.0)

    @property
    def framed(self) -> bool:
        """Whether the options leave it to the scan where the camera is."""
        return self.eye is None and self.target is None

    def camera(self, scan: Any) -> Any:
        """The camera for a `Scan`."""
        framed = scan.camera(self._frame)
        if self.framed:
            return replace(framed, aperture=self.lens["aperture"], focus=self.lens["focus"])
        target = self.target or scan.middle
        # Without an eye: as far away, and on the same side, as to frame it.
        eye = self.eye or [e + a - t for e, a, t in zip(framed.eye, target, framed.target, strict=True)]
        return self._looking(eye, target, scan.up)

    def turning(self, scan: Any) -> Any:
        """The camera for a `Scan` that turns; where the options say nothing, it stays in the picture all the way.

        Not for a panorama, which is all around the camera: `CameraPath` has refused its turntable, and keys do without.
        """
        if self.framed and self.lens["projection"] != "panorama":
            framed = scan.turning(self._frame)
            return replace(framed, aperture=self.lens["aperture"], focus=self.lens["focus"])
        return self.camera(scan)

    @property
    def _frame(self) -> Any:
        """What framing takes of the lens."""
        from ..staging.framing import Lens

        return Lens(self.lens["fov"], self.size, self.lens["projection"])

    def _looking(self, eye: Any, target: Any, up: Any) -> Any:
        from ..rendering.camera import Camera

        return Camera.look_at(eye, target, up, size=self.size, **self.lens)


class SceneView:
    """The camera of a scene file, as `View` is that of the options.

    Parameters
    ----------
    told : dict
        What `Camera.look_at` or `Camera.frame` is told.
    """

    def __init__(self, told: dict[str, Any]) -> None:
        from ..scenefile.plan import BOX, camera_of

        camera = camera_of(told, BOX)  # all but eye and target are as told
        self.size, self.up = camera.size, camera.up
        self.lens = {name: getattr(camera, name) for name in ("fov", "projection", "aperture", "focus")}
        self.settings = {"camera": told}
