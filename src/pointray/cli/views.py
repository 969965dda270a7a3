"""The camera of options or of a scene file."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

from .picture_options import IN_CAMERA, OF_VIEW, PictureOptions

LENS = ("fov", "projection", "aperture", "focus")


class View:
    """The camera of images of a scan: given by options, or positioned automatically once the scan is read.

    Raises ValueError if an option is invalid.

    Attributes
    ----------
    eye, target : (3,) tuple or None
        Values of --eye and --target.
    size : (int, int)
        Width and height in pixels.
    lens : dict
        fov, projection, aperture and focus, as for `Camera.look_at`.
    choice : ViewChoice
        Options of the automatic camera: up direction, side, angles and zoom.
    """

    def __init__(self, options: PictureOptions) -> None:
        from ..auto_view.first_view import ViewChoice

        values = options.of(IN_CAMERA)
        self.eye, self.target, self.size = options.eye, options.target, options.size
        self.lens = {name: values[name] for name in LENS}
        self.choice = ViewChoice(options.up, **options.of(OF_VIEW))
        if not self.framed and self.choice != ViewChoice(options.up):
            raise ValueError(
                "--view, --azimuth, --elevation and --zoom are for the automatic camera, without --eye and --target"
            )
        if options.focus is not None and not options.aperture:
            raise ValueError("--focus requires --aperture")
        near = self.eye or (0.0, 0.0, 0.0)
        probe = self.target or [x + 1 + abs(x) for x in near]
        self._look_at(near, probe, self.up)

    @property
    def inputs(self) -> dict[str, Any]:
        """All options that the cameras of a turntable depend on besides the image size, as JSON values.

        If they have changed, all frames of an interrupted animation are rendered again.
        """
        return {"eye": self.eye, "target": self.target, **asdict(self.choice), **self.lens}

    @property
    def up(self) -> Any:
        """Up direction for use before the scan is read; z if it is automatic."""
        return self.choice.up or (0.0, 0.0, 1.0)

    @property
    def framed(self) -> bool:
        """Whether the camera is positioned automatically: neither --eye nor --target is given."""
        return self.eye is None and self.target is None

    def camera(self, scan: Any) -> Any:
        """Return the camera of an image, from options or automatic. scan : `Scan`, with its up and view direction"""
        from ..auto_view.coverage import LEAST
        from ..base.warning_log import warn

        framed = scan.camera(self._framing_lens)
        if self.framed:
            return replace(framed, aperture=self.lens["aperture"], focus=self.lens["focus"])
        target = self.target or scan.middle
        # Without --eye, direction and distance are those of the automatic camera.
        eye = self.eye or [e + a - t for e, a, t in zip(framed.eye, target, framed.target, strict=True)]
        camera = self._look_at(eye, target, scan.up)
        share = scan.coverage(camera)
        if share < LEAST:
            warn(
                f"the points cover only {share:.1%} of the image; without --eye and --target all are visible",
                stacklevel=2,
            )
        return camera

    def turning(self, scan: Any) -> Any:
        """Return the first camera of a turntable. An automatic one keeps the scan in the image through the whole turn.

        This does not hold for a panorama, for which `CameraPath` rejects a turntable; keyframes do not use this camera.

        scan : `Scan`, with its up and view direction
        """
        if self.framed and self.lens["projection"] != "panorama":
            framed = scan.turning(self._framing_lens)
            return replace(framed, aperture=self.lens["aperture"], focus=self.lens["focus"])
        return self.camera(scan)

    @property
    def _framing_lens(self) -> Any:
        """Field of view, image size and projection, as a `Lens`, which position an automatic camera."""
        from ..auto_view.framing import Lens

        return Lens(self.lens["fov"], self.size, self.lens["projection"])

    def _look_at(self, eye: Any, target: Any, up: Any) -> Any:
        from ..rendering.camera import Camera

        return Camera.look_at(eye, target, up, size=self.size, **self.lens)


class SceneView:
    """The camera of a scene file, with the attributes of `View` that animations need: size, up, lens and inputs.

    values : arguments of `Camera.look_at`, or of `Camera.frame` for a camera that shows the whole scene
    """

    def __init__(self, values: dict[str, Any]) -> None:
        from ..scenefile.plan import BOX, camera_of

        camera = camera_of(values, BOX)  # only its eye and target depend on the bounds
        self.size, self.up = camera.size, camera.up
        self.lens = {name: getattr(camera, name) for name in LENS}
        self.inputs = {"camera": values}
