"""From a scan and the options of `render` and `animate` to a scene."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np

from ..auto_view import STUDIO
from ..auto_view.first_view import ViewChoice
from ..base.choices import AUTO, EXPOSED, MUTED, SAME
from ..cloud.normals.validation import select_normals
from ..cloud.points import Points
from ..shade.lights import SunLight
from ..surface.splats.radii import radii_in
from .baked_light import FIRST, LightSource, light_source
from .options import background_of, settings_of
from .scan_files import ScanFiles
from .scan_lights import ScanLights
from .scan_material import ScanMaterial
from .scan_surface import as_option, check_saved, surface_of
from .views import View
from .waiting import Progress, in_background

PLAIN = {
    "surface": None,
    "samples": 4,
    "radius_scale": 1.0,
    "smooth": "auto",
    "scatter": AUTO,
    "scatter_size": 1.0,
}  # the surface without options
SURFACE = tuple(PLAIN)
LENS = ("fov", "projection", "aperture", "focus")
FRAMING = ("eye", "target", "view", "azimuth", "elevation", "zoom")
EFFORT = ("spp", "max_depth", "time_limit", "noise", "denoise", "seed", "threads", "levels", "backfaces")
APPEARANCE = ("light", "fill", "background", "ground", "contact_shadow", "material", "color", "color_by")


def staged(scan: ScanFiles, options: dict[str, Any], layers: bool = False) -> tuple[View, Any, ScanScene]:
    """The view, settings and scene of a scan from all options of `render` or `animate`, see `picture_options`.

    A wrong option raises ValueError at once.

    layers : whether the result is layers for other programs, not a picture to look at
    """
    from ..auto_view.studio import with_contact

    plain = {name: getattr(value, "value", value) for name, value in options.items()}
    lens, framing, effort, surface, appearance = (
        {k: plain[k] for k in names} for names in (LENS, FRAMING, EFFORT, SURFACE, APPEARANCE)
    )
    view = View(plain["size"], plain["up"], lens, **framing)
    mutes = effort["backfaces"] is None  # unless many are seen; what was chosen stays
    effort["backfaces"] = MUTED if mutes else effort["backfaces"]
    settings = with_contact(settings_of(options["integrator"], options["filter"], **effort))
    baked = light_source(settings, plain["bake"], plain["quick"])
    scan_scene = ScanScene(scan, surface, appearance, view.choice, layers, plain["normals"], baked)
    scan_scene.auto_backfaces = mutes
    return view, settings, scan_scene


class ScanScene:
    """A scan with its lights. A wrong option raises ValueError before the file is read.

    Parameters
    ----------
    files : ScanFiles
    surface : dict
        The parameters of `Model` in PLAIN; smooth is a text or a number.
    appearance : dict
        Texts of the options light, background, material and perhaps color and color_by; fill, a number or None;
        ground, contact_shadow and perhaps neutral, see `ScanMaterial`, bools.
    choice : ViewChoice
        How to view the scan.
    layers : bool
        Whether the background is part of the scene, as layers need it. A picture gets it as a backdrop.
    normals : {"auto", "file", "fit"}
        The normals to use, as for `select_normals`.
    baked : LightSource, optional
        Where baked light comes from; None: none is wanted.

    Attributes
    ----------
    read : Points or None
        What a scan held, once it has been built: its model may have other normals.
    auto_backfaces : bool
        Whether back faces that settings mute are not muted where many are seen.
    """

    def __init__(
        self,
        files: ScanFiles,
        surface: dict[str, Any],
        appearance: dict[str, Any],
        choice: ViewChoice,
        layers: bool = False,
        normals: str = AUTO,
        baked: LightSource | None = None,
    ) -> None:
        import pointray as pr

        surface = surface_of(surface)
        self.files, self._surface, self._appearance = files, surface, appearance
        self._choice = choice
        self._normals, self._baked, self._layers = normals, baked, layers
        self._scan: Any = None  # what was found about the model, unless it is in parts
        check_saved(files.files[0], surface == PLAIN and normals == AUTO)
        self.read: Points | None = None
        self.auto_backfaces = True
        self._unkept: tuple[Any, Any, list[str]] | None = None  # what `keep` keeps
        self._lights = ScanLights(appearance["light"], appearance["fill"])
        colors = appearance.get("color"), appearance.get("color_by"), appearance.get("neutral", False)
        self._material = ScanMaterial(appearance["material"], *colors)
        self._scene = pr.Scene()
        self._background = background_of(appearance["background"])
        self._scene.background = self._background  # raises ValueError if it is wrong
        # A colour becomes the backdrop of a picture, which the exposure does not change.
        if not layers and not isinstance(self._background, str):
            self._scene.background = None

    @property
    def inputs(self) -> dict[str, Any]:
        """What the scene depends on, as values of JSON."""
        baked = {} if self._baked is None else self._baked.inputs
        return {
            **self.files.inputs,
            **self._surface,
            "normals": self._normals,
            "auto_backfaces": self.auto_backfaces,
            **self._appearance,
            **asdict(self._choice),
            **baked,
        }

    @property
    def backdrop(self) -> Any:
        """The backdrop of the picture, as `write_image` takes it."""
        from ..image.tone import GRADIENT, linear_to_srgb

        if self._appearance["background"] == AUTO:
            return GRADIENT
        if not isinstance(self._background, tuple):
            return None
        color = tuple(linear_to_srgb(np.array(self._background)).tolist())
        return color, color

    @property
    def legend(self) -> Any:
        """The attribute that colours the scan, with the range shown and the name that the user gave."""
        assert self._material.attribute is not None
        return replace(self._scene.shown_attributes[0], name=self._material.attribute.name)

    def build(self, progress: Progress) -> tuple[Any, Any, Any]:
        """The scene, the model in it, and a `Scan` that tells what was found out about it."""
        from ..auto_view.first_view import Scan

        self.files.check()
        model = self._load(progress)
        scan = in_background(lambda: Scan(model, self._choice))
        self._scene.add(model, material=self._material.build(model.points, scan.up))
        bounds = scan.bounds if scan.ignored else model.bounds
        if self._appearance["ground"]:
            self._scene.add(ground_under(bounds, scan.up))
        self._scene.lights = self._lights.make(bounds.mean(axis=0), scan.up, self._front(model, scan))
        self._scan = None if model.parts else scan
        return self._scene, model, scan

    def shown_with(self, settings: Any, camera: Any) -> Any:
        """The settings for pictures of what `build` has made.

        Without baked light where that was not worth it, and without muted back faces where many would be muted.
        """
        from ..auto_view.fronts import shows_backs
        from ..auto_view.studio import with_direct_light

        settings = with_direct_light(settings) if self._baked is None else settings
        may_change = self.auto_backfaces and settings.backfaces != SAME
        if may_change and (self._scan is None or shows_backs(self._scene, camera)):
            return replace(settings, backfaces=SAME)
        return settings

    def shadow(self, settings: Any) -> Any:
        """The contact shadow of what `build` has made; None if it does not stand, or pictures have no room for one.

        Its light is the studio's, and what is behind it is a backdrop.
        """
        from ..auto_view.contact import contact_shadow

        wanted = self._appearance["contact_shadow"] and not self._appearance["ground"]
        fits = wanted and settings.integrator in EXPOSED and self._lights.look == STUDIO
        if not fits or self.backdrop is None or self._layers or self._scan is None or not self._scan.stands:
            return None
        scan = self._scan
        key = next((light.direction for light in self._scene.lights if isinstance(light, SunLight)), None)
        return in_background(lambda: contact_shadow(self._scene, scan.positions, scan.up, key))

    def _front(self, model: Any, scan: Any) -> float | None:
        """Where the key light stands, see `ScanLights.make`; a room, or a model in parts, is not baked unasked."""
        if self._baked is None:
            return None
        outlook = scan.natural_outlook
        if (outlook.within or model.parts) and self._baked.quick:
            self._baked = None
            return None
        return float(round(outlook.azimuth))  # options of views do not change it

    @property
    def one_color(self) -> tuple[float, float, float] | None:
        """The linear colour that options give to all points, if they do."""
        return self._material.one_color

    @property
    def bakes(self) -> bool:
        """Whether light is baked."""
        return self._baked is not None and self._baked.file is None

    @property
    def may_level(self) -> bool:
        """Whether the model may get levels of detail: its surface is the usual one, and no file has light for it."""
        return self._surface == PLAIN and (self._baked is None or self._baked.file is None)

    def light(self, progress: Progress, told: str = FIRST) -> None:
        """Give the scene its baked light, if that is wanted: after `build`, and after levels of detail are made.

        told : what is said if it is baked as somebody wanted
        """
        if self._baked is not None:
            self._baked.light(self._scene, progress, told)

    def _load(self, progress: Progress) -> Any:
        """The model of the files, which are a scan or a saved model."""
        import pointray as pr

        from ..model.model_cache import built

        files, saved = self.files, self.files.saved
        progress.show("reading", 0.0)
        if saved is not None:
            return in_background(lambda: pr.Model.load(saved))
        entry = files.entry(normals=self._normals, **self._surface)
        found = entry and in_background(entry.load)
        if found is not None:
            found.levels = ()  # a picture is the same whether its model was kept or built
            self._material.build(found.points, self._choice.up)
            return found
        model, notes = built(lambda: self._built(progress))
        self._unkept = None if entry is None else (entry, model, notes)
        return model

    def keep(self, progress: Progress) -> None:
        """Keep a model that was built for the next time, if that is wanted: after the picture."""
        if self._unkept is not None:
            entry, model, notes = self._unkept
            self._unkept = None
            in_background(lambda: entry.store(model, notes, partial(progress.show, "keeping the model for next time")))

    def _built(self, progress: Progress) -> Any:
        """The model of a scan, read and built."""
        import pointray as pr

        from ..rendering.warmup import NORMALS, expect

        files = self.files
        points = self.read = in_background(lambda: files.read(partial(progress.show, "reading")))
        if points.normals is None or self._normals == "fit":
            expect(NORMALS)
        self._material.build(points, self._choice.up)  # raises ValueError if an option is wrong
        radii = radii_in(points)
        progress.show("normals", 0.0)
        try:
            trusty = in_background(
                lambda: select_normals(points, self._normals, progress=partial(progress.show, "normals"))
            )
            return in_background(lambda: pr.Model(trusty, radii, **self._surface, progress=progress.show))
        except ValueError as error:
            raise ValueError(f"{files.name}: {as_option(error)}") from error


def ground_under(bounds: Any, up: tuple[float, float, float]) -> Any:
    """A plane under a box."""
    from ..scene.instances import Plane

    return Plane([low if u >= 0 else high for u, low, high in zip(up, *bounds, strict=True)], up)
