"""The panel: its folders, made of the view settings and the scene."""

from __future__ import annotations

from typing import NamedTuple

from ..auto_view import LOOKS, STUDIO
from ..base.choices import AUTO, BACKFACES, COLORMAPS, CURVES, EXPOSED, INTEGRATORS, LIGHTS, SCATTER, SURFACES
from ..model.model import SURFACE
from ..scene.scene import Scene
from ..shade.attributes import COORDINATES
from .controls import Control, Folder
from .light_control import MAX_LIGHTS, OWN as OWN_LIGHT, POINT, SKY, SUN, LightControl
from .shared_scene import Build, SharedScene
from .view_settings import CHANGED, CONSTANT, MATERIALS, OWN, ViewSettings, color_attributes

COUNTS = (1, 4, 16, 64, 256, 1024, 4096)
MOUSE_HELP = (
    "Drag: orbit. Right drag: pan. Wheel: zoom.\nDouble click: set the target. Click: query a point.\n?: all keys."
)


class Output(NamedTuple):
    """Options of saved images and animations.

    width, height : pixels; samples : per pixel; format : of images: "png", "jpg" or "exr"
    seconds, fps : duration and frame rate of animations
    """

    width: int = 1920
    height: int = 1080
    samples: int = 16
    format: str = "png"
    denoise: bool = False
    seconds: float = 6.0
    fps: float = 24.0


def folders(view: ViewSettings, shared: SharedScene, output: Output, scene: Scene | None) -> list[Folder]:
    """Return the panel as a list of folders with their controls. scene : None while there is none

    view, output : give the values; shared : gives the surface options and the preset of the lights
    """
    build = shared.build
    if scene is None:
        return [Folder("View", [Control("help", "", "note", MOUSE_HELP)], open=True)]
    material = [] if not scene.models else [_material(view, scene)]
    surface = [] if build is None else [_surface(build)]
    in_parts = any(model.parts for model in scene.models)
    return [
        _view(view, any(model.has_levels for model in scene.models)),
        _light(view, bool(scene.lights) and not shared.look, shared.look == STUDIO and not in_parts),
        *material,
        *surface,
        _cut(view),
        _save(output, bool(shared.source)),
        _film(output),
    ]


def _view(view: ViewSettings, has_levels: bool) -> Folder:
    around = [("gradient", "gradient"), ("color", "single colour"), ("sky", "sky light"), ("scene", "from the scene")]
    depth = (
        [_range(view, "max_depth", "Bounces", 0, max(32, view.max_depth), 1)]
        if view.integrator in ("phong", "path")
        else []
    )
    hint = "Show averaged points where points are smaller than pixels: faster, less flicker"
    levels = [Control("levels", "Levels of detail", "switch", view.levels, hint=hint)] if has_levels else []
    return Folder(
        "View",
        [
            _choice(view, "integrator", "Show", list(INTEGRATORS.items())),
            Control(
                "samples",
                "Samples",
                "choice",
                view.samples,
                [(count, f"{count:,}") for count in sorted({*COUNTS, view.samples})],
                hint="Samples per pixel of the refined image",
            ),
            *depth,
            *levels,
            Control("exposes", "Auto exposure", "switch", view.exposes, hint="Medium brightness, highlights preserved"),
            _range(
                view, "exposure", "Exposure", -6, 6, 0.1, "In stops, each doubles the light; added to auto exposure"
            ),
            _choice(view, "curve", "Curve", [(AUTO, "automatic"), *CURVES.items()]),
            _choice(view, "around", "Background", around),
            *([Control("backdrop", "Colour", "color", view.backdrop)] if view.around == "color" else []),
            Control("help", "", "note", MOUSE_HELP),
        ],
        open=True,
    )


def _light(view: ViewSettings, has_own: bool, allows_contact_shadow: bool) -> Folder:
    """Return the folder with the lights and their controls.

    has_own : whether the scene has lights of its own
    allows_contact_shadow : whether the scene gets a contact shadow if it stands and studio light is chosen
    """
    looks = [*LOOKS.items(), *([(OWN_LIGHT, "from the scene")] if has_own else [])]
    look = view.look
    if look == CHANGED:
        looks.append((CHANGED, "custom, see below"))
    rows = [Control("look", "Light", "choice", look, looks, hint="Replaces the lights below")]
    if view.integrator in ("phong", "baked"):
        rows.append(Control("shadows", "Shadows", "switch", view.shadows))
        hint = "How surfaces seen from behind are shown"
        kinds = [(name, name) for name in BACKFACES]
        rows.append(Control("backfaces", "Back faces", "choice", view.backfaces, kinds, hint=hint))
    if allows_contact_shadow and look == STUDIO and view.integrator in EXPOSED:
        hint = "Shadow of a standing object on an invisible ground"
        rows.append(Control("contact_shadow", "Contact shadow", "switch", view.contact_shadow, hint=hint))
    if not view.lamps:
        instead = {
            "phong": "No lights: headlight at the camera.",
            "path": "No lights: uniform white sky.",
            "baked": "No lights: the scene is dark.",
        }
        rows.append(Control("no_lamps", "", "note", instead.get(view.integrator, "No lights, none needed.")))
    for k, lamp in enumerate(view.lamps[:MAX_LIGHTS]):
        rows += _lamp(f"lamps.{k}.", k, lamp)
    if len(view.lamps) > MAX_LIGHTS:
        rows.append(Control("more_lamps", "", "note", f"And {len(view.lamps) - MAX_LIGHTS:,} more lights, all on."))
    rows.append(Control("lamps.add.sun", "Add a sun", "button", hint="Rotate it with Ctrl + drag"))
    rows.append(Control("lamps.add.point", "Add a point light", "button"))
    if not any(lamp.kind == SKY for lamp in view.lamps):
        rows.append(
            Control("lamps.add.sky", "Add a sky", "button", hint="Uniform light from all directions, for path tracing")
        )
    return Folder("Light", rows, open=True)


def _lamp(at: str, number: int, lamp: LightControl) -> list[Control]:
    """Return the controls of one light. at : prefix of their names, such as "lamps.0."; number : index of the light"""
    name = LIGHTS.get(lamp.kind, type(lamp.light).__name__)
    rows = [Control(f"{at}on", f"{number + 1}: {name}", "switch", lamp.on)]
    if lamp.kind != OWN_LIGHT:
        top = max(100.0, 100.0 * lamp.strength)
        rows.append(Control(f"{at}color", "Colour", "color", lamp.color))
        rows.append(
            Control(f"{at}strength", "Strength", "range", lamp.strength, low=0.01, high=top, step=0.01, log=True)
        )
    if lamp.kind == SUN:
        rows += [
            Control(f"{at}azimuth", "Azimuth (°)", "range", lamp.azimuth, low=-180, high=180, step=1),
            Control(f"{at}elevation", "Elevation (°)", "range", lamp.elevation, low=-90, high=90, step=1),
            Control(
                f"{at}angle",
                "Diameter (°)",
                "range",
                lamp.angle,
                low=0,
                high=30,
                step=0.01,
                hint="Diameter of the disk: softens shadows of path tracing",
            ),
        ]
    if lamp.kind in (SUN, POINT):
        rows.append(Control(f"{at}camera", "Fixed to the camera", "switch", lamp.camera))
    if lamp.kind == POINT:
        rows.append(Control(f"{at}position", "Position", "vector", lamp.position))
    return [*rows, Control(f"{at}remove", "Remove", "button")]


def _material(view: ViewSettings, scene: Scene) -> Folder:
    kinds = [(OWN, "from the scene"), *((name, name) for name in MATERIALS)]
    rows = [_choice(view, "material", "Material", kinds)]
    if view.material not in ("mirror", "glass"):
        own = [(OWN, "from the points"), (CONSTANT, "single colour")]
        rows.append(_choice(view, "color_by", "Colour", [*own, *((name, name) for name in color_attributes(scene))]))
        if view.color_by == CONSTANT:
            rows.append(Control("color", "", "color", view.color))
        elif view.color_by != OWN:
            rows.append(_choice(view, "colormap", "Colormap", [(name, name) for name in COLORMAPS]))
            rows += _limits(view)
    more = {
        "phong": [("specular", "Specular", 0.0, 1.0, 0.01), ("exponent", "Phong exponent", 1.0, 1000.0, 1.0)],
        "principled": [("roughness", "Roughness", 0.0, 1.0, 0.01), ("metallic", "Metallic", 0.0, 1.0, 0.01)],
        "glass": [("ior", "Refractive index", 1.0, 3.0, 0.01)],
    }
    rows += [_range(view, *row) for row in more.get(view.material, [])]
    return Folder("Material", rows)


def _limits(view: ViewSettings) -> list[Control]:
    """Return the two controls of the colour scale's minimum and maximum; none until the attribute's range is known."""
    rows = []
    for name, label in (("low", "Minimum"), ("high", "Maximum")):
        rows.append(Control(name, label, "number", getattr(view, name)))
    return rows if view.low is not None else []


def _surface(build: Build) -> Folder:
    kinds = sorted(SURFACES.items(), key=lambda kind: kind[0] != SURFACE)  # the default first
    return Folder(
        "Surface (for all browsers)",
        [
            Control("build.surface", "Surface", "choice", build.surface, kinds),
            Control(
                "build.samples",
                "Samples",
                "range",
                build.samples,
                low=2,
                high=16,
                step=1,
                hint="Samples along a ray per support diameter",
            ),
            Control(
                "build.radius_scale",
                "Radius scale",
                "range",
                build.radius_scale,
                low=0.5,
                high=2.0,
                step=0.05,
                hint="Factor of all support radii",
            ),
            Control(
                "build.scatter",
                "Scattered points",
                "choice",
                build.scatter,
                list(SCATTER.items()),
                hint="Points that lie on no surface, such as leaves and wires",
            ),
            *_scattered(build),
            Control("build.measured", "Measure noise", "switch", build.measured, hint="Smooth the measured noise"),
            Control(
                "build.noise",
                "Noise level",
                "range",
                build.noise,
                low=0.0,
                high=2.0,
                step=0.01,
                hint="Noise to smooth: standard deviation in median radii",
            ),
        ],
    )


def _scattered(build: Build) -> list[Control]:
    """Return the control of the size of scattered points; none unless they are drawn as spheres or discs."""
    if build.scatter not in ("spheres", "discs"):
        return []
    size = build.scatter_size
    return [Control("build.scatter_size", "Size of these", "range", size, low=0.2, high=3.0, step=0.05)]


def _cut(view: ViewSettings) -> Folder:
    rows = []
    for k, cut in enumerate(view.cuts):
        rows.append(Control(f"cuts.{k}.on", f"Cut {COORDINATES[k]}", "switch", cut.on))
        if cut.on:
            rows.append(Control(f"cuts.{k}.at", "Position", "range", cut.at, low=0.0, high=1.0, step=0.001))
            rows.append(Control(f"cuts.{k}.flip", "Flip", "switch", cut.flip))
    ground = Control("ground", "Ground", "switch", view.ground, hint="Grey plane under the model")
    return Folder("Cuts and ground", [*rows, ground])


def _save(output: Output, has_command: bool) -> Folder:
    formats = [("png", "PNG"), ("jpg", "JPEG"), ("exr", "EXR")]
    return Folder(
        "Picture",
        [
            Control("output.width", "Width (px)", "number", output.width, low=1, high=8192),
            Control("output.height", "Height (px)", "number", output.height, low=1, high=8192),
            Control("output.samples", "Samples", "number", output.samples, low=1, high=65536),
            Control("output.format", "Format", "choice", output.format, formats),
            Control(
                "output.denoise", "Denoise", "switch", output.denoise, hint="For path tracing and ambient occlusion"
            ),
            Control("save.picture", "Save picture", "button"),
            *([Control("copy.command", "Copy as command", "button")] if has_command else []),
            Control("copy.python", "Copy as Python", "button"),
        ],
    )


def _film(output: Output) -> Folder:
    return Folder(
        "Film",
        [
            Control("output.seconds", "Duration (s)", "number", output.seconds, low=0.1, high=600),
            Control("output.fps", "Frames per second", "number", output.fps, low=1, high=120),
            Control("save.film", "Record turntable", "button", hint="At the size of the picture above"),
            Control("save.stop", "Stop", "button"),
        ],
    )


def _choice(view: ViewSettings, name: str, label: str, options: list[tuple[str, str]]) -> Control:
    return Control(name, label, "choice", getattr(view, name), options)


def _range(view: ViewSettings, name: str, label: str, low: float, high: float, step: float, hint: str = "") -> Control:
    return Control(name, label, "range", getattr(view, name), low=low, high=high, step=step, hint=hint)
