"""The scene that `pointray render` and `pointray view` make of scans without options, for functions of the same names.

Points become models; the models stand in the studio's light, which is baked roughly, as its first image should not
wait.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..baking.baked import Baked, bake
from ..baking.settings import BakeSettings
from ..base.arguments import wrong_type
from ..base.arrays import Floats
from ..base.choices import AUTO, EXPOSED, MUTED, SAME
from ..base.progress import StageProgress
from ..cloud.normals.validation import select_normals
from ..cloud.points import Points
from ..engine.jit import Array
from ..image.exposure import tone_of, white_under
from ..image.tone import GRADIENT
from ..image.write import displayed
from ..io.exchange.convert import SUPPORTED, as_points, converter_of, is_path, is_paths
from ..io.files import read
from ..model.building import ignore_progress
from ..model.model import Model
from ..model.scan_inputs import files_of, is_saved
from ..rendering.camera import Camera
from ..rendering.settings import Settings
from ..scene.scene import Scene
from ..shade.lights import SunLight
from ..shade.materials.diffuse import Diffuse
from ..surface.splats.radii import radii_in
from .contact import ContactShadow, contact_shadow
from .first_view import Scan, ViewChoice
from .framing import STANDARD
from .fronts import shows_backs
from .studio import CLAY, studio, with_direct_light

SIZE = (800, 600)
QUICK = {"patches": 16384, "links": 16, "noise": 1.0}  # of `BakeSettings`: takes one to two seconds, see docs/decisions
KINDS = f"a Scene, a Model, {SUPPORTED}, or a list of these"


def quick_bake(settings: Settings) -> BakeSettings:
    """Return settings for light that is baked without a request: roughly, in one to two seconds."""
    return replace(BakeSettings(seed=settings.seed, threads=settings.threads), **QUICK)  # type: ignore[arg-type]


def own_material(points: Points) -> Diffuse:
    """Return the material of a scan: diffuse in its points' colours, or in the colour of clay."""
    return Diffuse(None if points.colors is not None else CLAY)


def model_of(x: Any, name: str, progress: StageProgress | None = None) -> Model:
    """Return anything that `as_points` accepts, a model, or the path of a saved one, as a model.

    Points get normals as the command line gives them, and the radii in their attribute "radius", if there is one.

    name : of the parameter, in messages; progress : called with stages and shares
    """
    report = progress or ignore_progress
    if isinstance(x, Model):
        return x
    if is_path(x) and is_saved(Path(x)):
        return Model.load(x)
    if is_path(x) and Path(x).suffix.lower() == ".toml":
        raise ValueError(f"{x}: a scene file: pass scene, camera and settings of `load_scene`")
    if is_path(x) or is_paths(x):
        files: Any = files_of(x)
        points = read(files, progress=report)
    else:
        points = x if isinstance(x, Points) else as_points(x, name, KINDS)
    report("normals", 0.0)
    fitting = select_normals(points, progress=report)
    return Model(fitting, radii_in(points), progress=report)


def models_of(x: Any, name: str, progress: StageProgress | None = None) -> list[Model]:
    """Return one or several things that `model_of` accepts as models; all scans among paths in a list are one cloud."""
    if not is_list_of_clouds(x, name):
        return [model_of(x, name, progress)]
    scans = [one for one in x if _is_scan(one)]
    return [model_of(one, name, progress) for one in ([scans] * bool(scans) + [o for o in x if not _is_scan(o)])]


def _is_scan(x: Any) -> bool:
    return is_path(x) and not is_saved(Path(x))


def is_list_of_clouds(x: Any, name: str) -> bool:
    """Return whether an object is a list of clouds, models and files; raise TypeError if only some elements are.

    name : of the parameter, in messages
    """
    if not isinstance(x, list | tuple) or not any(map(is_cloud, x)):
        return False
    for k, one in enumerate(x):
        if not is_cloud(one):
            raise wrong_type(f"{name}[{k}]", KINDS.removesuffix(", or a list of these"), one)
    return True


def is_cloud(x: Any) -> bool:
    """Return whether an element of a list is a cloud, a model or a file, not a row or a number of an array."""
    if is_path(x) or isinstance(x, Points | Model):
        return True
    if isinstance(x, list | tuple):
        return False
    names = getattr(getattr(x, "dtype", None), "names", None)
    return converter_of(x) is not None and (names is not None or getattr(x, "ndim", 2) == 2)


@dataclass
class DefaultScene:
    """A scene of models in the studio's light, with the view that was found for it.

    Attributes
    ----------
    scene : Scene
    scan : Scan
        Its up and view directions.
    settings : Settings
        Of its images.
    """

    scene: Scene
    scan: Scan
    settings: Settings

    @property
    def camera(self) -> Camera:
        """The automatic camera."""
        return self.scan.camera(STANDARD._replace(size=SIZE))


def default_scene(
    models: Sequence[Model], settings: Settings | None = None, up: Any = None, progress: StageProgress | None = None
) -> DefaultScene:
    """Return a scene of models in the studio's light, baked if its images show baked light.

    settings : None: those of `pointray render`; up : (3,), None: chosen automatically
    """
    scene = Scene()
    for model in models:
        scene.add(model, material=own_material(model.points))
    scan = Scan(scene, ViewChoice(up))
    shown = Settings("baked", spp=4, backfaces=MUTED) if settings is None else settings
    in_parts = any(model.parts for model in models)
    front = fixed_front(scan, True, in_parts) if shown.integrator == "baked" else None
    scene.lights = studio(scan.up, front)
    made = DefaultScene(scene, scan, shown)
    if shown.integrator == "baked" and front is None:
        made.settings = with_direct_light(shown)
    elif shown.integrator == "baked":
        scene.baked = bake(scene, quick_bake(shown), progress)
    if settings is None:
        made.settings = with_visible_backs(made.settings, scene, made.camera, in_parts)
    return made


def fixed_front(scan: Scan, quick: bool, in_parts: bool = False) -> float | None:
    """Return the azimuth in degrees of the view for which the studio's lights are fixed, so that they can be baked.

    Return None if they are not baked: without a request, in rooms and for models in parts.

    quick : whether light is baked without a request; in_parts : whether a model is in parts
    """
    outlook = scan.natural_outlook
    return None if quick and (outlook.within or in_parts) else float(round(outlook.azimuth))


def with_visible_backs(settings: Settings, scene: Scene, camera: Camera, in_parts: bool) -> Settings:
    """Return settings that light back faces like front faces if many of them are visible, or the model is in parts."""
    if settings.backfaces != SAME and (in_parts or shows_backs(scene, camera)):
        return replace(settings, backfaces=SAME)
    return settings


def shadow_under(scene: Scene, scan: Scan) -> ContactShadow:
    """Return the shadow of a standing object in the studio's light on an invisible ground."""
    key = next((light.direction for light in scene.lights if isinstance(light, SunLight)), None)
    return contact_shadow(scene, scan.positions, scan.up, key)


def frame(scene: Scene) -> Camera:
    """Return the automatic camera for a scene, as `pointray.frame` does."""
    return Scan(scene, ViewChoice()).camera()


def render(
    x: Any, camera: Camera | None, settings: Settings | None, draw: Any, progress: StageProgress | None
) -> Array:
    """Return the picture that `pointray render` writes of scans, points or models; see `pointray.render`.

    The result is linear, so that `write_image` without options writes these pixels.

    draw : called with scene, camera and settings, returns an image of linear radiance
    """
    models = models_of(x, "scene", progress)
    made = default_scene(models, settings, progress=progress)
    seen = made.camera if camera is None else camera
    image: Floats = draw(made.scene, seen, made.settings)
    lit = made.settings.integrator in EXPOSED
    white = white_under(made.scene.lights, made.settings.integrator)
    exposure, curve = tone_of(image, AUTO if lit else 0.0, AUTO, white)
    if lit and made.scan.stands and not any(model.parts for model in models):
        image = shadow_under(made.scene, made.scan).put_under(image, seen)
    return displayed(image, exposure, curve, GRADIENT)


def baked(x: Any, settings: BakeSettings | None, progress: StageProgress | None, client: Any) -> Baked:
    """Bake the studio's light for scans, points or models; see `pointray.bake`."""
    scene = Scene()
    for model in models_of(x, "scene", progress):
        scene.add(model, material=own_material(model.points))
    scan = Scan(scene, ViewChoice())
    scene.lights = studio(scan.up, fixed_front(scan, False))
    return bake(scene, settings, progress, client)
