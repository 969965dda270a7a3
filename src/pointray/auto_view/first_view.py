"""Automatic camera: `frame`, and `Scan`, which keeps what was detected in a scan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import Vector, check_choice, check_direction, check_number
from ..base.arrays import Doubles
from ..base.choices import AUTO, VIEWS
from ..base.warning_log import warn
from ..cloud.conversion import PointsLike, check_points
from ..cloud.points import Points
from ..model.model import Model
from ..rendering.camera import SIZE, Camera
from ..scene.scene import Scene
from .coverage import LEAST, coverage, of_largest_cluster
from .direction import OBJECT, Outlook, find_outlook, towards
from .framing import STANDARD, WHOLE, Lens, Part, frame_points, frame_turning, magnified
from .sample import Sample, sample_of
from .upright import find_up, stands_along

AXES = ("x", "y", "z", "-x", "-y", "-z")
MOST_ZOOM = 1000.0
WIDE = 75.0  # degrees: smallest field of view of a camera inside a room
BACK = (0.4, 0.3, 0.2, 0.1, 0.0)  # tried distances of the camera from a room's centre, as shares of its width
CLEAR = 0.05  # smallest distance to surfaces, as a share of a room's width


@dataclass(frozen=True)
class ViewChoice:
    """User options of a view. Values of None are chosen automatically.

    Attributes
    ----------
    up : (3,) tuple or None
    view : str
        "auto", "iso", "front", "back", "left", "right", "top" or "bottom".
    azimuth, elevation : float or None
        Degrees; they override those of the view.
    zoom : float
        Zoom factor relative to the automatic camera; 2 halves the distance.
    """

    up: Vector | None = None
    view: str = AUTO
    azimuth: float | None = None
    elevation: float | None = None
    zoom: float = 1.0

    def __post_init__(self) -> None:
        check_choice(self.view, "view", (AUTO, *VIEWS))
        for name, most in (("azimuth", 36000.0), ("elevation", 90.0)):
            _check_angle(getattr(self, name), name, most)
        check_number(self.zoom, "zoom", f"between {1 / MOST_ZOOM:g} and {MOST_ZOOM:g}", _is_zoom)


class Scan:
    """Points of a scene with the up direction and the view direction that were detected or chosen for them.

    Parameters
    ----------
    subject : Scene, Model or Points
    choice : ViewChoice

    Attributes
    ----------
    up : (3,) tuple
    found_up : Up or None
        Automatic up direction with the reason. None if the choice has one.
    outlook : Outlook
        View direction.
    ignored : str
        Message about points that are not framed; empty if all are.
    """

    def __init__(self, subject: Scene | Model | Points, choice: ViewChoice) -> None:
        self._sample = sample_of(subject, islands=False)
        self._choice = choice
        self.ignored = str(self._sample.ignored)
        self.found_up = find_up(self._sample) if choice.up is None else None
        self.up = choice.up or self.found_up.direction  # type: ignore[union-attr]  # set if the choice has none
        self.outlook = self._look()

    @property
    def found(self) -> str:
        """Line for the user with the automatic choices, reasons and options that change them; empty without any."""
        up = self.found_up
        view = f"view: {self.natural_outlook.kind}" if self._is_found else ""
        parts = [view, f"up {up.axis if up.axis.startswith('-') else f'+{up.axis}'} ({up.why})" if up else ""]
        options = " and ".join(["--view"] * self._is_found + ["--up"] * (up is not None))
        text = f"{', '.join(filter(None, parts))}. Change with {options}." if options else ""
        return " ".join(filter(None, (text, self.ignored)))

    @cached_property
    def natural_outlook(self) -> Outlook:
        """Automatic view direction, also if the user has chosen another one."""
        return find_outlook(self._sample, self.up)

    @cached_property
    def stands(self) -> bool:
        """Whether the points show an object from all sides that stands on a base, feet or a trunk.

        Such objects get a contact shadow.
        """
        if self.natural_outlook.kind != OBJECT:
            return False
        return self.found_up.stands if self.found_up is not None else stands_along(self._sample, self.up)

    @property
    def positions(self) -> Doubles:
        """Points that the camera frames, without distant ones, (n, 3), world."""
        return np.asarray(self._sample.origin + self._sample.positions)

    @property
    def middle(self) -> Vector:
        """Median of the points that the camera frames, world."""
        x, y, z = (self._sample.origin + np.median(self._sample.positions, axis=0)).tolist()
        return x, y, z

    @property
    def bounds(self) -> Doubles:
        """Bounding box of the points that the camera frames: minimum and maximum, (2, 3), world."""
        low, high = self._sample.positions.min(axis=0), self._sample.positions.max(axis=0)
        return np.asarray(self._sample.origin + [low, high])

    def camera(self, lens: Lens = STANDARD, free: Part = WHOLE) -> Camera:
        """Return the camera that frames all points, centred and as large as fits, or shows a room from inside.

        If the points would cover less than 0.5% of the image, it frames the largest cluster, if that helps, and warns.

        lens : field of view, size and projection
        free : part of the image that the points fill: left, top, right, bottom, from 0 to 1
        """
        direction = towards(self.outlook, self.up)
        if self.outlook.within and lens.projection == "perspective":
            return _within(self._sample, direction, self.up, lens._replace(fov=max(lens.fov, WIDE)))
        camera = self._near(frame_points(self._sample, direction, self.up, lens, free))
        share = self.coverage(camera)
        if share >= LEAST or self._choice.zoom > 1:
            return camera
        nearer = self._near(frame_points(of_largest_cluster(self._sample), direction, self.up, lens, free))
        if self.coverage(nearer) <= share:
            warn(f"the points cover only {share:.1%} of the image", stacklevel=3)
            return camera
        warn(f"the points would cover only {share:.1%} of the image: the largest cluster is framed", stacklevel=3)
        return nearer

    def coverage(self, camera: Camera) -> float:
        """Return the approximate share of a camera's image that points cover."""
        return coverage(self._sample.origin + self._sample.positions, camera)

    def turning(self, lens: Lens = STANDARD) -> Camera:
        """Return the first camera of a turntable, with the scan inside the image through the whole turn about `up`.

        lens : field of view, size and projection
        """
        direction = towards(self.outlook, self.up)
        return self._near(frame_turning(self._sample, direction, self.up, lens))

    @property
    def _is_found(self) -> bool:
        """Whether the view direction is chosen automatically."""
        choice = self._choice
        return choice.view == AUTO and choice.azimuth is None and choice.elevation is None

    def _look(self) -> Outlook:
        choice = self._choice
        outlook = self.natural_outlook if choice.view == AUTO else Outlook(*VIEWS[choice.view], choice.view)
        if choice.azimuth is not None:
            outlook = outlook._replace(azimuth=choice.azimuth, within=False)
        if choice.elevation is not None:
            outlook = outlook._replace(elevation=choice.elevation, within=False)
        return outlook

    def _near(self, camera: Camera) -> Camera:
        """Return a camera with the user's zoom: nearer, or, if orthographic, with a narrower field of view.

        An orthographic eye must stay in front of the scan.
        """
        if camera.projection == "orthographic":
            return magnified(camera, self._choice.zoom)
        eye, target = np.asarray(camera.eye), np.asarray(camera.target)
        return replace(camera, eye=tuple(target + (eye - target) / self._choice.zoom))


def frame(
    subject: Scene | Model | PointsLike,
    view: str = AUTO,
    up: ArrayLike | str = AUTO,
    fov: float = 40,
    size: tuple[int, int] = SIZE,
    projection: str = "perspective",
    azimuth: float | None = None,
    elevation: float | None = None,
    zoom: float = 1.0,
) -> Camera:
    """Return a camera that shows a subject upright, centred and as large as fits.

    Parameters
    ----------
    subject : Scene, Model, or what `as_points` accepts
        The central 99.9% of its points along each side of the image are framed. Clusters that are farther away than
        the size of the scan are not framed if they have at most 2% of the points.
    view : {"auto", "iso", "front", "back", "left", "right", "top", "bottom"}
        The front is seen from -y if z is up, and from +z if y is up. "auto" shows objects from the front, slightly
        from the right and above; flat scans from 40 degrees above; one-sided scans from that side; rooms from inside.
    up : (3,) array_like, or "x", "-x", "y", "-y", "z", "-z", or "auto"
        "auto" chooses the axis with the most evidence: large coordinates, the file format, a depth camera at the
        origin, the shape and normals of the scan, and common practice (z, then y).
    fov, size, projection
        As for `Camera.look_at`: vertical field of view in degrees, (width, height) in pixels, kind of projection.
    azimuth, elevation : float, optional
        Degrees; they override those of the view. (0, 0) is the front, (90, 0) the right side.
    zoom : float
        Zoom factor relative to the automatic camera; 2 halves the distance.

    Returns
    -------
    Camera

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a parameter is invalid, or there are no points.

    Warns
    -----
    UserWarning
        If the points would cover less than 0.5% of the image. The largest cluster is framed then, if that helps.

    Examples
    --------
    >>> camera = pr.frame(pr.procedural("sphere", 1000), view="front", size=(320, 240))
    >>> camera.size, camera.up
    ((320, 240), (0.0, 0.0, 1.0))
    """
    if not isinstance(subject, Scene | Model):
        subject = check_points(subject, "subject")
    lens = Camera.look_at((0, 0, 0), (1, 0, 0), fov=fov, size=size, projection=projection)
    scan = Scan(subject, ViewChoice(up_of(up), view, azimuth, elevation, zoom))
    return scan.camera(Lens(lens.fov, lens.size, lens.projection))


def up_of(up: Any) -> Vector | None:
    """Return the up direction as a vector; None for "auto".

    up : (3,) array_like, "x", "-x", "y", "-y", "z", "-z" or "auto"; ValueError for anything else
    """
    from .upright import axis_direction

    if isinstance(up, str):
        if up == AUTO:
            return None
        if up not in AXES:
            raise ValueError(f"up must be three numbers, auto, or one of {', '.join(AXES)}, got {up!r:.40}")
        return axis_direction(up)
    return check_direction(up, "up")


def _within(sample: Sample, direction: Doubles, up: Vector, lens: Lens) -> Camera:
    """Return a camera inside a room that looks across its centre.

    direction : (3,), from the points towards the camera; lens : field of view, size and projection
    """
    middle = np.median(sample.positions, axis=0)
    width = float(np.ptp(np.quantile(sample.positions @ direction, [0.01, 0.99])))
    for share in BACK:
        eye = middle + share * width * direction
        if np.linalg.norm(sample.positions - eye, axis=1).min() > CLEAR * width:
            break
    return Camera.look_at(sample.origin + eye, sample.origin + eye - direction * width / 2, up, *lens)


def _is_zoom(value: float) -> bool:
    return 1 / MOST_ZOOM <= value <= MOST_ZOOM


def _check_angle(value: float | None, name: str, most: float) -> None:
    if value is not None:
        wanted = f"a number of degrees between {-most:g} and {most:g}, or None"
        check_number(value, name, wanted, lambda x: -most <= x <= most)
