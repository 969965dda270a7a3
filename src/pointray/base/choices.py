"""Names of choices in options, scene files and the viewer's panel, each with a description.

Kernels identify surfaces, projections, filters and integrators by their index in these tables, see `number_of`. Saved
models contain the indices of surfaces: append new ones at the end.
"""

from __future__ import annotations

from collections.abc import Iterable

AUTO = "auto"

SURFACES = {"paper": "the paper's", "imls": "imls", "apss": "spheres (apss)", "disc": "discs"}

AS_SPHERES, AS_SURFACE = "spheres", "surface"  # defaults of SCATTER, without and with given radii
SCATTER = {  # drawing of scattered points, which lie on no surface
    AS_SPHERES: "one sphere a point",
    "discs": "one disc a point",
    AS_SURFACE: "part of the surface, without detection",
    "none": "not drawn",
}

INTEGRATORS = {
    "phong": "Phong: direct light, shadows",
    "ao": "Ambient occlusion",
    "path": "Path tracing: all light",
    "normal": "Normals",
    "depth": "Depth",
    "color": "Colours, unlit",
    "cost": "Cost: nodes and leaves",
    "baked": "Baked: all light, stored in the points",
}
EXPOSED = ["phong", "ao", "path", "baked"]  # exposure and tone mapping apply to their images
NOISY = ["ao", "path"]  # use random sampling

FILTERS = {
    "box": "1 pixel wide",
    "tent": "2 pixels wide",
    "gaussian": "soft, 3 pixels wide",
    "blackman-harris": "smooth, 3 pixels wide",
}

PROJECTIONS = {
    "perspective": "distant objects appear smaller",
    "orthographic": "parallel rays, same size at the target",
    "panorama": "360 x 180 degrees",
}

CURVES = {"srgb": "sRGB", "neutral": "neutral", "filmic": "filmic", "soft": "soft"}

MATERIALS = {  # of the command line; Python and scene files use the classes of shade/materials/
    "own": "matt, in its own colours",
    "clay": "matt, in one colour",
    "phong": "with a highlight",
    "metal": "rough metal",
    "glass": "clear",
}

LIGHTS = {"sun": "Sun", "point": "Point light", "sky": "Sky"}  # of the command line and the panel

SAME, MUTED = "same", "muted"
BACKFACES = {
    MUTED: "desaturated and never black, so that holes in a scan stay recognisable",
    SAME: "lit like front faces",
}

NORMALS = {
    "auto": "from the file; estimated if their median deviation from the surface exceeds 15 degrees",
    "file": "from the file",
    "fit": "estimated",
}

VIEWS = {  # azimuth (0: front, 90: right) and elevation, degrees
    "iso": (45.0, 35.264),
    "front": (0.0, 0.0),
    "back": (180.0, 0.0),
    "left": (-90.0, 0.0),
    "right": (90.0, 0.0),
    "top": (0.0, 90.0),
    "bottom": (0.0, -90.0),
}

COLORMAPS = [  # available in every installation
    *("viridis", "magma", "inferno", "plasma", "cividis", "turbo", "gray", "coolwarm", "RdBu", "terrain", "twilight"),
    *("tab10", "tab20"),
]


def number_of(choices: Iterable[str], name: str) -> int:
    """Return the index of a name among `choices`, by which kernels identify the choice."""
    return list(choices).index(name)


def listed(choices: dict[str, str]) -> str:
    """Return "name: description; name: description" for the help text of an option. choices : descriptions by name"""
    return "; ".join(f"{name}: {meaning}" for name, meaning in choices.items())
