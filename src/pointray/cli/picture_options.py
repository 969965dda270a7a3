"""The options of pictures, each declared once: for `render`, `animate`, `view`, `bake`, and beside scene files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ..auto_view import STUDIO
from ..base.choices import (
    AUTO,
    BACKFACES,
    FILTERS,
    INTEGRATORS,
    MATERIALS,
    NORMALS,
    PROJECTIONS,
    SCATTER,
    SURFACES,
    VIEWS,
    listed,
)
from .declare import CAMERA, CLUSTER, INPUT, LIGHT, LOOK, QUALITY, declarations, option
from .options import Vector, linear_rgb, numbers, positive, size_of, smooth_of, up_axis

# The commands that have an option.
PICTURES = ("render", "animate")
SHOWN, COLORED, SCENES = (*PICTURES, "view"), (*PICTURES, "bake"), (*PICTURES, "view", "bake")
SCANS, SHARED = (*SCENES, "prepare"), (*COLORED, "prepare")

# The parts that options belong to. TABLES are tables of scene files: there the option replaces the key of its name,
# or `bake.file`.
IN_CAMERA, IN_SETTINGS, IN_ROOT, IN_BAKE = TABLES = ("camera", "settings", "root", "bake")
OF_VIEW, OF_SURFACE, OF_SCENE = "view", "surface", "scene"  # of a scan: `ViewChoice`, `Model`, lights and materials
OF_WORKERS = "workers"

UNBAKED = ("glass",)  # materials that show little of baked light

_camera = partial(option, panel=CAMERA, commands=PICTURES, part=IN_CAMERA)
_view = partial(option, panel=CAMERA, commands=PICTURES, part=OF_VIEW)
_light = partial(option, panel=LIGHT, commands=SCENES, part=OF_SCENE)
_look = partial(option, panel=LOOK, commands=SCENES, part=OF_SCENE)
_surface = partial(option, panel=LOOK, commands=SCENES, part=OF_SURFACE)
_quality = partial(option, panel=QUALITY, commands=PICTURES, part=IN_SETTINGS)
_workers = partial(option, panel=CLUSTER, commands=SHARED, part=OF_WORKERS)


@dataclass(frozen=True)
class PictureOptions:
    """The parsed values of the options of pictures, which `render`, `animate`, `view`, `bake` and other commands share.

    Each default declares the option: its default, metavar, help, group in --help (`panel`), the commands that have it,
    and its `part`, what it belongs to: a table of scene files ("camera", "settings", "root", "bake"), or for scans the
    "view", "surface", "scene" or "workers".
    """

    eye: Vector | None = _camera(None, "X,Y,Z", "Camera position. Default: the scan fills the image.", parse=numbers)
    target: Vector | None = _camera(None, "X,Y,Z", "Point to look at. Default: the middle of the scan.", parse=numbers)
    up: Vector | None = _camera(
        AUTO,
        "AXIS",
        "Up direction: z, y, -y, ... or x,y,z; auto: found from the shape.",
        commands=SCENES,
        parse=up_axis,
    )
    view: str = _view(
        AUTO, "SIDE", f"Side to show: {', '.join(VIEWS)}; auto: the most informative.", choices=(AUTO, *VIEWS)
    )
    azimuth: float | None = _view(None, "DEGREES", "Angle around the scan: 0 is the front, 90 the right side.")
    elevation: float | None = _view(None, "DEGREES", "Angle above the horizon, -90 to 90.")
    zoom: float = _view(1.0, "FACTOR", "Zoom factor relative to the automatic camera; 2 halves the distance.")
    fov: float = _camera(40.0, "DEGREES", "Vertical field of view.")
    size: tuple[int, int] = _camera(
        "800x600", "WxH", "Width and height of the image in pixels.", commands=(*PICTURES, "demo"), parse=size_of
    )
    projection: str = _camera("perspective", "NAME", f"Projection. {listed(PROJECTIONS)}.", choices=PROJECTIONS)
    aperture: float = _camera(0.0, "LENGTH", "Diameter of the lens in units of the scan; 0: no depth of field.")
    focus: float | None = _camera(None, "LENGTH", "Distance that is in focus. Default: that of the target.")

    light: list[str] | None = _light(
        None,
        "LIGHT",
        "studio (default): a key light with shadows, and a sky; headlight: a lamp at the camera. Or, repeatable, "
        "sun:dx,dy,dz (direction of travel) or point:x,y,z, then optionally :strength and ,camera to move it with the "
        "camera (x right, y up, z towards the eye); sky:r,g,b or sky:FILE (.hdr or .exr environment map).",
    )
    fill: float | None = _light(
        None, "SHARE", "Sky light added to --light sun and point, as a share of a sun's; 0: none. Default: 0.3."
    )
    integrator: str | None = _light(
        None,
        "NAME",
        "phong: direct light and shadows; ao: ambient occlusion; path: all light, with noise; baked: all light, baked "
        "first or taken from --bake; normal; depth; color: unlit colours; cost: visited nodes and leaves. Default: "
        "baked for scans in the studio's light, unless they are glass or coloured by an attribute; otherwise phong.",
        choices=INTEGRATORS,
        commands=SHOWN,
        part=IN_SETTINGS,
    )
    bake: Path | None = _light(
        None,
        "FILE",
        "Use light baked by `pointray bake` with the same options. Implies --integrator baked.",
        commands=SHOWN,
        part=IN_BAKE,
    )
    exposure: str = _light(
        AUTO, "STOPS", "Exposure; auto: medium brightness without clipped highlights.", commands=PICTURES, part=IN_ROOT
    )

    material: str = _look("own", "NAME", f"Material. {listed(MATERIALS)}.", choices=MATERIALS, commands=COLORED)
    color: Vector | None = _look(
        None, "R,G,B", "One colour for the whole scan: linear, 0 to 1.", commands=COLORED, parse=linear_rgb
    )
    color_by: str | None = _look(
        None,
        "NAME",
        "Colour by height, x, y, z or an attribute (see `pointray info`), then optionally :colormap and :low,high.",
        commands=COLORED,
    )
    legend: bool = _look(False, None, "Draw the legend of --color-by.", commands=("render",), part="")
    background: str = _look(
        AUTO,
        "COLOR",
        "auto: a gradient, whatever the exposure; r,g,b: linear; none: transparent; sky: the environment light.",
        commands=SHOWN,
        part=IN_ROOT,
    )
    ground: bool = _look(
        False, None, "Add a grey plane under the scan. Points of the ground: --keep classification=ground."
    )
    contact_shadow: bool = _look(
        True,
        None,
        "Draw the shadow of a standing object on an invisible ground, in the studio's light.",
        commands=SHOWN,
    )
    backfaces: str | None = _look(
        None,
        "NAME",
        f"Back faces with phong and baked. {listed(BACKFACES)}. Default: muted, or same if more than a quarter of the "
        "visible surface are back faces, as in trees.",
        choices=BACKFACES,
        commands=SHOWN,
        part=IN_SETTINGS,
    )
    surface: str | None = _surface(
        None, "NAME", f"Surface definition: {', '.join(SURFACES)}. Default: apss.", choices=SURFACES
    )
    radius_scale: float = _surface(1.0, "FACTOR", "Factor for all radii of the surface.", kind=float, parse=positive)
    scatter: str = _surface(
        AUTO,
        "NAME",
        f"How to draw points that lie on no surface: leaves, wires. {listed(SCATTER)}; auto: spheres, or surface if "
        "the file has radii.",
        choices=(AUTO, *SCATTER),
        commands=SCANS,
    )
    scatter_size: float = _surface(
        1.0,
        "FACTOR",
        "Factor for the radii of these points; 1: 0.35 of the local spacing.",
        commands=SCANS,
        kind=float,
        parse=positive,
    )
    normals: str = _look(
        AUTO, "NAME", f"Normals to use. {listed(NORMALS)}.", panel=INPUT, choices=NORMALS, commands=SCANS, part=""
    )
    smooth: float | str = _surface(
        AUTO,
        "SIGMA",
        "Noise to smooth away, as a standard deviation; auto: as measured; 0: none.",
        panel=INPUT,
        parse=smooth_of,
    )
    cache: bool = option(
        True,
        None,
        "Store the model of a scan and reuse it next time, see `pointray cache`.",
        panel=INPUT,
        commands=SHOWN,
    )

    spp: int = _quality(4, "COUNT", "Samples per pixel; with a time or noise limit 1 means no limit.")
    max_depth: int = _quality(4, "COUNT", "Scatterings along a path; for phong: mirrors and panes in a row.")
    time_limit: float | None = _quality(None, "SECONDS", "Stop adding samples after this many seconds.")
    noise: float | None = _quality(
        None, "SHARE", "Stop at this standard error relative to the mean of the image, such as 0.02."
    )
    denoise: bool = _quality(False, None, "Denoise images of path and ao.")
    filter: str = _quality("blackman-harris", "NAME", f"Pixel filter. {listed(FILTERS)}.", choices=FILTERS)
    samples: int = _surface(
        4, "COUNT", "Samples along a ray in the diameter of a support.", panel=QUALITY, min=2, max=64
    )
    levels: bool = _quality(True, None, "Show levels of detail of distant models.", commands=SHOWN)
    seed: int = _quality(0, "NUMBER", "Seed of random numbers.", commands=COLORED)

    threads: int | None = option(
        None, "COUNT", "Threads. Default: POINTRAY_THREADS, or all cores.", panel=CLUSTER, part=IN_SETTINGS
    )
    cluster: str | None = _workers(
        None, "ADDRESS", "Use the workers of a trusted Dask scheduler, such as tcp://host:8786 (manual: Large scans)."
    )
    workers: int | None = _workers(None, "COUNT", "Use this many local Dask processes, which share the cores.", min=1)
    spread: bool = _workers(
        False,
        None,
        "Spread a model in parts over the workers and send rays between them: for models too large for one.",
        "--spread",
        commands=PICTURES,
    )

    def __post_init__(self) -> None:
        if self.bake is not None and self.integrator not in (None, "baked"):
            raise ValueError(f"--bake requires --integrator baked, not {self.integrator}")

    @property
    def is_quick(self) -> bool:
        """Whether light is baked without a request: in the default lights ("studio"), without --integrator and --bake.

        False for scans that are glass or coloured by an attribute.
        """
        chosen = self.integrator is not None or self.bake is not None
        own_look = self.color_by is None and self.material not in UNBAKED
        return not chosen and own_look and (self.light or [STUDIO]) == [STUDIO]

    @property
    def shown(self) -> str:
        """Name of the integrator: the one given, else "baked" with --bake or by default (studio), else "phong"."""
        return self.integrator or ("baked" if self.is_quick or self.bake is not None else "phong")

    def of(self, part: str) -> dict[str, Any]:
        """Return by name the values of the options that belong to `part`, such as "camera", "surface" or "workers"."""
        return {name: getattr(self, name) for name in names_of(part)}

    def parsed(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the options that the user typed, with the parsed values of this instance instead of the typed ones.

        given : typed values by name; those of options that this class does not have are returned unchanged
        """
        return {name: getattr(self, name, value) for name, value in given.items()}


def names_of(*parts: str) -> tuple[str, ...]:
    """Return the names of the options that belong to one of `parts`, such as "camera", "surface" or "workers"."""
    return tuple(name for name, declared in declarations(PictureOptions).items() if declared.part in parts)
