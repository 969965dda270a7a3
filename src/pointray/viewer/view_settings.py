"""View settings of one browser: all values of its panel, but neither the camera nor settings that browsers share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ..auto_view import HEADLIGHT, STUDIO
from ..auto_view.direction import axes_of
from ..auto_view.studio import CLAY
from ..base.arguments import Vector
from ..base.arrays import Floats
from ..base.choices import AUTO, EXPOSED, SAME
from ..cloud.georeference import RESIDUAL
from ..image.exposure import tone_of, white_under
from ..image.tone import GRADIENT, Backdrop, linear_to_srgb, srgb_to_linear
from ..model.model import Model
from ..rendering.settings import Settings
from ..scene.instances import Plane
from ..scene.paints import check_attribute
from ..scene.scene import Scene
from ..shade.attributes import COORDINATES, Attribute
from ..shade.environment import EnvironmentLight
from ..shade.lights import Light
from ..shade.materials.base import Material
from ..shade.materials.diffuse import Diffuse
from ..shade.materials.phong import Phong
from ..shade.materials.principled import Principled
from ..shade.materials.specular import Dielectric, Mirror
from .light_control import Color, LightControl, controls_of, light_controls_of, new_light_control
from .shared_scene import SharedScene

CHANGED = "changed"  # lights that the user has edited
OWN, CONSTANT = "own", "constant"  # colours: those of the points, or a single one
BACKDROP = (0.93, 0.94, 0.955)  # sRGB, default background colour

# Values that affect the image but not the scene: `apply` does not depend on them.
NOT_IN_SCENE = (
    *("base", "integrator", "samples", "max_depth", "shadows", "backfaces", "contact_shadow", "levels", "exposure"),
    *("curve", "studio"),
)


@dataclass(frozen=True)
class Cut:
    """A plane across an axis that cuts the model open: removes the part at greater coordinates.

    on : whether it cuts; at : position as a fraction of the model's bounds; flip : remove the other part
    """

    on: bool = False
    at: float = 0.5
    flip: bool = False  # whether to keep the part at greater coordinates


@dataclass(frozen=True)
class ViewSettings:
    """Values of the panel, each under the name of its control.

    Attributes
    ----------
    base : Settings
        Settings without a control in the panel.
    integrator : str
        What is computed, such as "phong" (direct light), "path", "baked", "normal" or "depth".
    max_depth : int
        Maximum number of bounces of a path; for "phong" and "baked", of mirrors and glass in a row.
    shadows : bool
        Whether direct light casts shadows.
    backfaces : {"same", "muted"}
        Back faces are shaded like front faces, or desaturated and never black.
    levels : bool
        Whether levels of detail are used.
    samples : int
        Samples per pixel of a refined image.
    exposes : bool
        Whether exposure is automatic; `exposure` (stops) is then added to it.
    curve : str
        Tone curve; "auto": chosen together with the exposure.
    contact_shadow : bool
        Whether a standing object gets a contact shadow, put under the image.
    backdrop : (3,) sRGB
    around : str
        Background: "gradient" (grey, from top to bottom), "color" (`backdrop`), "sky" (the environment light) or
        "scene" (the scene's own background).
    lamps : tuple of LightControl
        Lights of the image.
    studio : tuple of LightControl
        Lights of the studio, if it was chosen; compared with `lamps` to detect edits.
    material : str
        "own": that of each instance; otherwise one for all models, such as "phong".
    color_by : str
        "own": the points' colours; "constant": `color` (sRGB); or the name of an attribute, drawn with `colormap`.
    low, high : float or None
        Range of the attribute; None: automatic.
    specular, exponent, roughness, metallic, ior
        Parameters of the materials.
    ground : bool
        Whether there is a grey plane under the model.
    cuts : (3,) tuple of Cut
        Planes across x, y and z that cut the scene open.
    """

    base: Settings = Settings()
    integrator: str = "phong"
    samples: int = 64
    max_depth: int = 4
    shadows: bool = True
    backfaces: str = SAME
    contact_shadow: bool = True
    levels: bool = True
    exposes: bool = False
    exposure: float = 0.0
    curve: str = AUTO
    around: str = "gradient"
    backdrop: Color = BACKDROP
    lamps: tuple[LightControl, ...] = ()
    studio: tuple[LightControl, ...] = ()
    material: str = OWN
    color_by: str = OWN
    color: Color = (0.8, 0.8, 0.8)
    colormap: str = "viridis"
    low: float | None = None
    high: float | None = None
    specular: float = 0.2
    exponent: float = 20.0
    roughness: float = 0.4
    metallic: float = 0.0
    ior: float = 1.5
    ground: bool = False
    cuts: tuple[Cut, Cut, Cut] = (Cut(), Cut(), Cut())

    @classmethod
    def of(cls, shared: SharedScene, scene: Scene) -> ViewSettings:
        """Return the initial values of the panel.

        shared : gives render settings, exposure and tone curve; scene : gives lights and background
        """
        settings = shared.settings
        view = cls(
            base=replace(settings, time_limit=None, noise=None, denoise=False),
            integrator=settings.integrator,
            samples=max(settings.spp, 64),
            max_depth=settings.depth,
            shadows=settings.shadows,
            backfaces=settings.backfaces,
            contact_shadow=shared.contact_shadow,
            levels=settings.levels,
            exposes=shared.exposes,
            exposure=shared.exposure,
            curve=AUTO if shared.exposes else shared.curve,
        )
        lamps = light_controls_of(scene, shared.up)
        return replace(view, lamps=lamps, studio=lamps if shared.look == STUDIO else ()).with_background(scene)

    def with_background(self, scene: Scene) -> ViewSettings:
        """Return a copy of these settings with the background of a scene."""
        if scene.shows_sky:
            return replace(self, around="sky")
        if scene.background is None:
            return replace(self, around="gradient")
        r, g, b = linear_to_srgb(np.clip(scene.background, 0, 1)).tolist()
        return replace(self, around="color", backdrop=(r, g, b))

    def same_scene(self, other: ViewSettings) -> bool:
        """Return whether both settings change a scene in the same way, so that its copy can be reused.

        Values are compared by identity, because lights may hold arrays.
        """
        names = [field.name for field in fields(self) if field.name not in NOT_IN_SCENE]
        return all(getattr(self, name) is getattr(other, name) for name in names)

    def with_value(self, name: str, value: Any) -> ViewSettings:
        """Return a copy with a new value of a control.

        name : a field, or a field of a light or a cut, such as "lamps.0.color"
        """
        field, _, rest = name.partition(".")
        if not rest:
            return replace(self, **{field: value})
        number, _, part = rest.partition(".")
        parts = list(getattr(self, field))
        parts[int(number)] = replace(parts[int(number)], **{part: value})
        changed: dict[str, Any] = {field: tuple(parts)}
        return replace(self, **changed)

    @property
    def look(self) -> str:
        """Preset of the lights: "studio", "headlight" (no lights), or "changed" if they are neither."""
        if not self.lamps:
            return HEADLIGHT
        same = len(self.lamps) == len(self.studio)
        return STUDIO if same and all(a is b for a, b in zip(self.lamps, self.studio, strict=True)) else CHANGED

    def in_studio(self, lights: Sequence[Light | EnvironmentLight], up: Vector) -> ViewSettings:
        """Return a copy lit by a studio. Its light is baked instead of direct, unless it is fixed to the camera.

        lights : those of the studio; up : direction about which their angles are measured
        """
        lamps = controls_of(lights, up)
        baked = self.integrator == "phong" and not any(lamp.camera for lamp in lamps)
        return replace(self, lamps=lamps, studio=lamps, integrator="baked" if baked else self.integrator)

    def lit_by(self, lights: Sequence[Light | EnvironmentLight], up: Vector, integrator: str) -> ViewSettings:
        """Return a copy with other lights. up : direction about which their angles are measured

        integrator : replaces the current one if that is "baked"; but if there are no lights, "phong" does
        """
        shown = self.integrator if self.integrator != "baked" else integrator if lights else "phong"
        return replace(self, lamps=controls_of(lights, up), integrator=shown)

    def with_lamp(self, kind: str, scene: Scene, up: Vector) -> ViewSettings:
        """Return a copy with an additional light of default values. kind : "sun", "point" or "sky"

        scene : a point light is placed by the bounds of this scene; up : up direction of the scene
        """
        return replace(self, lamps=(*self.lamps, new_light_control(kind, scene, up)))

    def without_lamp(self, number: int) -> ViewSettings:
        """Return a copy without a light. number : its index in `lamps`"""
        return replace(self, lamps=self.lamps[:number] + self.lamps[number + 1 :])

    def settings(self, spp: int) -> Settings:
        """Return the settings of an image with the given number of samples per pixel."""
        shown: dict[str, Any] = {"integrator": self.integrator, "max_depth": self.max_depth, "shadows": self.shadows}
        return replace(self.base, spp=spp, levels=self.levels, backfaces=self.backfaces, **shown)

    @property
    def auto_exposed(self) -> bool:
        """Whether exposure is automatic: chosen by the user, and the image shows light, not normals or depth."""
        return self.exposes and self.integrator in EXPOSED

    def tone(self, image: Floats) -> tuple[float, str]:
        """Return exposure (stops) and tone curve (its name) for an image, (h, w, 4) float32, linear with alpha."""
        if not self.auto_exposed:
            return tone_of(image, self.exposure, self.curve)
        white = white_under(self.lights((0.0, 0.0, 1.0)), self.integrator)  # any up direction will do
        stops, curve = tone_of(image, AUTO, self.curve, white)
        return stops + self.exposure, curve

    @property
    def behind(self) -> Backdrop:
        """Colours behind transparent pixels at the top and at the bottom of an image, sRGB."""
        return GRADIENT if self.around == "gradient" else (self.backdrop, self.backdrop)

    def lights(self, up: Vector) -> list[Light | EnvironmentLight]:
        """Return the lights that are on, for `Scene.lights`. up : direction about which their angles are measured"""
        return [lamp.make(up) for lamp in self.lamps if lamp.on]

    def apply(self, scene: Scene, up: Vector) -> Scene:
        """Return a copy of a scene with these lights, materials, cuts, ground and background.

        up : direction about which angles of lights are measured, and the normal of the ground
        """
        applied = scene.copy()
        applied.lights = self.lights(up)
        applied.background = "environment" if self.around == "sky" else srgb_to_linear(np.array(self.backdrop))
        if self.around == "gradient" or (self.around == "color" and self.exposes):
            applied.background = None  # the backdrop is composited after exposure
        if self.around == "scene":
            applied.background = "environment" if scene.shows_sky else scene.background
        low, high = scene.bounds
        if self.ground:
            top = axes_of(up)[2]
            applied.add(Plane(np.where(top >= 0, low, high), up))
        applied.clips = [*map(tuple, scene.clips), *self._clips(low, high)]
        if self.material != OWN or self.color_by != OWN:
            for number, shape in scene.shapes.items():
                if isinstance(shape, Model):
                    applied.update(number, material=self._material(shape.points.colors is None))
        return applied

    def _clips(self, low: Any, high: Any) -> list[tuple[Any, Any]]:
        """Return the planes of the cuts for `Scene.clips`: a point, and the direction of the part cut away.

        low, high : (3,), bounds of the scene
        """
        out = []
        for axis, cut in enumerate(self.cuts):
            if cut.on:
                normal = np.eye(3)[axis] * (-1.0 if cut.flip else 1.0)
                out.append((low + (high - low) * cut.at, normal))
        return out

    def _material(self, uncolored: bool) -> Material:
        """Return the material for a model. uncolored : whether its points have no colours and need a default"""
        color: Any = None
        if self.color_by == CONSTANT:
            color = srgb_to_linear(np.array(self.color))
        elif self.color_by != OWN:
            limits = None if self.low is None or self.high is None else (self.low, self.high)
            color = Attribute(self.color_by, self.colormap, limits)
        elif uncolored:
            color = CLAY
        return Diffuse(color) if self.material == OWN else MATERIALS[self.material](self, color)


# Materials in the panel besides those of the scene: name -> function of settings and colour.
MATERIALS: dict[str, Callable[[ViewSettings, Any], Material]] = {
    "diffuse": lambda view, color: Diffuse(color),
    "phong": lambda view, color: Phong(color, view.specular, view.exponent),
    "principled": lambda view, color: Principled(color, view.roughness, view.metallic),
    "mirror": lambda view, color: Mirror(),
    "glass": lambda view, color: Dielectric(view.ior),
}


_USABLE: WeakKeyDictionary[Model, list[str]] = WeakKeyDictionary()  # cached: finding them reads all values


def color_attributes(scene: Scene) -> list[str]:
    """Return names of attributes that can colour all models of a scene, and then the coordinates "x", "y" and "z"."""
    of_models = [_usable_attributes(model) for model in scene.models]
    return [*(name for name in of_models[0] if all(name in names for names in of_models)), *COORDINATES]


def _usable_attributes(model: Model) -> list[str]:
    if model not in _USABLE:
        names = []
        for name in (name for name in model.points.attributes if name != RESIDUAL):
            with suppress(ValueError):
                check_attribute(model.points, Attribute(name))
                names.append(name)
        _USABLE[model] = names
    return _USABLE[model]
