"""View settings of one browser: all values of its panel, but neither the camera nor settings that browsers share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ..auto_view import HEADLIGHT, STUDIO
from ..auto_view.direction import axes_of
from ..auto_view.studio import CLAY
from ..base.arguments import Vector
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
    """A plane across an axis that cuts the model open. at : position as a fraction of the bounds"""

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
    samples : int
        Samples per pixel of a refined image.
    exposes : bool
        Whether exposure is automatic; `exposure` is then added to it.
    curve : str
        AUTO: chosen together with the exposure.
    contact_shadow : bool
        Whether a standing object gets a contact shadow, see `Contacts`.
    backdrop : (3,) sRGB
    around : str
        Background: "gradient" that of `image.tone`; "color" the backdrop; "sky" the lights; "scene" that of the scene.
    studio : tuple of LightControl
        Lights of the studio, if it was chosen.
    material : str
        "own": that of each instance; otherwise one for all models.
    color_by : str
        OWN, CONSTANT, or an attribute of the points.
    low, high : float or None
        Range of the attribute; None: automatic.
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
        """Return the initial settings for a shared scene."""
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
        """Return these settings with the background of a scene."""
        if scene.shows_sky:
            return replace(self, around="sky")
        if scene.background is None:
            return replace(self, around="gradient")
        r, g, b = linear_to_srgb(np.clip(scene.background, 0, 1)).tolist()
        return replace(self, around="color", backdrop=(r, g, b))

    def same_scene(self, other: ViewSettings) -> bool:
        """Return whether both settings give the same scene; compared by identity, because lights may hold arrays."""
        names = [field.name for field in fields(self) if field.name not in NOT_IN_SCENE]
        return all(getattr(self, name) is getattr(other, name) for name in names)

    def with_value(self, name: str, value: Any) -> ViewSettings:
        """Return settings with a new value of a control: of a field, or of a light or a cut, like "lamps.0.color"."""
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
        """One of `auto_view.LOOKS` if the lights are those; otherwise CHANGED."""
        if not self.lamps:
            return HEADLIGHT
        same = len(self.lamps) == len(self.studio)
        return STUDIO if same and all(a is b for a, b in zip(self.lamps, self.studio, strict=True)) else CHANGED

    def in_studio(self, lights: Sequence[Light | EnvironmentLight], up: Vector) -> ViewSettings:
        """Return settings with the lights of a studio, whose light is baked unless they are fixed to the camera."""
        lamps = controls_of(lights, up)
        baked = self.integrator == "phong" and not any(lamp.camera for lamp in lamps)
        return replace(self, lamps=lamps, studio=lamps, integrator="baked" if baked else self.integrator)

    def lit_by(self, lights: Sequence[Light | EnvironmentLight], up: Vector, integrator: str) -> ViewSettings:
        """Return settings with other lights. integrator : replaces that of baked light"""
        shown = self.integrator if self.integrator != "baked" else integrator if lights else "phong"
        return replace(self, lamps=controls_of(lights, up), integrator=shown)

    def with_lamp(self, kind: str, scene: Scene, up: Vector) -> ViewSettings:
        """Return settings with an additional light."""
        return replace(self, lamps=(*self.lamps, new_light_control(kind, scene, up)))

    def without_lamp(self, number: int) -> ViewSettings:
        """Return settings without a light."""
        return replace(self, lamps=self.lamps[:number] + self.lamps[number + 1 :])

    def settings(self, spp: int) -> Settings:
        """Return the settings of an image with the given number of samples per pixel."""
        shown: dict[str, Any] = {"integrator": self.integrator, "max_depth": self.max_depth, "shadows": self.shadows}
        return replace(self.base, spp=spp, levels=self.levels, backfaces=self.backfaces, **shown)

    @property
    def auto_exposed(self) -> bool:
        """Whether the exposure of images is automatic."""
        return self.exposes and self.integrator in EXPOSED

    def tone(self, image: NDArray[np.float32]) -> tuple[float, str]:
        """Return exposure (stops) and curve for an image."""
        if not self.auto_exposed:
            return tone_of(image, self.exposure, self.curve)
        white = white_under(self.lights((0.0, 0.0, 1.0)), self.integrator)  # any up direction will do
        stops, curve = tone_of(image, AUTO, self.curve, white)
        return stops + self.exposure, curve

    @property
    def behind(self) -> Backdrop:
        """Backdrop of transparent pixels: sRGB above and below."""
        return GRADIENT if self.around == "gradient" else (self.backdrop, self.backdrop)

    def lights(self, up: Vector) -> list[Light | EnvironmentLight]:
        """Return the lights that are on."""
        return [lamp.make(up) for lamp in self.lamps if lamp.on]

    def apply(self, scene: Scene, up: Vector) -> Scene:
        """Return a copy of the scene with these settings; the scene itself is unchanged."""
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
        """Return the planes of the cuts: a point, and the direction of the part cut away."""
        out = []
        for axis, cut in enumerate(self.cuts):
            if cut.on:
                normal = np.eye(3)[axis] * (-1.0 if cut.flip else 1.0)
                out.append((low + (high - low) * cut.at, normal))
        return out

    def _material(self, uncolored: bool) -> Material:
        """Return the material for models. uncolored : whether the points have no colours"""
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
    """Return the attributes that can colour all models of a scene."""
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
