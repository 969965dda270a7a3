"""Choices: the words that options, scene files and the viewer's panel know, with what each is, once.

The numbers by which kernels know surfaces, projections, filters and integrators are indices of these tables, see
`number_of`; models that are saved hold those of surfaces: a new one goes to the end.
"""

from __future__ import annotations

from collections.abc import Iterable

AUTO = "auto"

SURFACES = {"paper": "the paper's", "imls": "imls", "apss": "spheres (apss)", "disc": "discs"}

AS_SPHERES, AS_SURFACE = "spheres", "surface"  # of SCATTER: unless radii are given, and if they are
SCATTER = {  # how points are drawn that lie on no surface
    AS_SPHERES: "spheres",
    "discs": "single discs",
    AS_SURFACE: "as all others, and not sought",
    "none": "left out",
}

INTEGRATORS = {
    "phong": "Phong: direct light, shadows",
    "ao": "Ambient occlusion",
    "path": "Path tracing: all light",
    "normal": "Normals",
    "depth": "Depth",
    "color": "Colours, unlit",
    "cost": "Cost: nodes and leaves",
    "baked": "Baked: all light, from what is kept in the points",
}
EXPOSED = ["phong", "ao", "path", "baked"]  # their pictures are light; others are shown as they are
NOISY = ["ao", "path"]  # they leave something to chance

FILTERS = {
    "box": "the pixel itself",
    "tent": "2 pixels wide",
    "gaussian": "soft, 3 pixels wide",
    "blackman-harris": "smooth, 3 pixels wide",
}

PROJECTIONS = {
    "perspective": "what is far away is smaller",
    "orthographic": "as high at the target",
    "panorama": "360 x 180 degrees",
}

CURVES = {"srgb": "sRGB", "neutral": "neutral", "filmic": "filmic", "soft": "soft"}

MATERIALS = {  # of the command line; Python and scene files have the classes of shade/materials/
    "own": "matt, in its own colours",
    "clay": "matt, in one colour",
    "phong": "with a highlight",
    "metal": "rough metal",
    "glass": "clear",
}

LIGHTS = {"sun": "Sun", "point": "Point light", "sky": "Sky"}  # of command line and panel

SAME, MUTED = "same", "muted"
BACKFACES = {
    MUTED: "greyer, and never black: holes of a scan are seen as holes",
    SAME: "lit as front faces are",
}

NORMALS = {
    "auto": "the file's unless they are a median of more than 15 degrees off the surface",
    "file": "the file's",
    "fit": "fitted ones",
}

VIEWS = {  # azimuth and elevation, degrees: 0 and 0 is the front, 90 to the right
    "iso": (45.0, 35.264),
    "front": (0.0, 0.0),
    "back": (180.0, 0.0),
    "left": (-90.0, 0.0),
    "right": (90.0, 0.0),
    "top": (0.0, 90.0),
    "bottom": (0.0, -90.0),
}

COLORMAPS = [  # that every installation has
    *("viridis", "magma", "inferno", "plasma", "cividis", "turbo", "gray", "coolwarm", "RdBu", "terrain", "twilight"),
    *("tab10", "tab20"),
]


def number_of(choices: Iterable[str], name: str) -> int:
    """A choice as kernels know it: its index."""
    return list(choices).index(name)


def listed(choices: dict[str, str]) -> str:
    """The choices as a help text says them."""
    return "; ".join(f"{name}: {meaning}" for name, meaning in choices.items())
