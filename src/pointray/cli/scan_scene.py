"""The scene of a scan, from the options of `render`, `animate` and `bake`."""

from __future__ import annotations

from dataclasses import asdict, replace
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
from .picture_options import IN_SETTINGS, OF_SCENE, OF_SURFACE, PictureOptions
from .scan_files import ScanFiles
from .scan_lights import ScanLights
from .scan_material import ScanMaterial
from .scan_surface import PLAIN, as_option, check_saved
from .views import View
from .waiting import Progress, in_background


def staged(scan: ScanFiles, options: PictureOptions, layers: bool = False) -> tuple[View, Any, ScanScene]:
    """Return the view, settings and scene of a scan; ValueError if an option is invalid.

    layers : whether the result is layers for other programs, not an image to look at
    """
    from ..auto_view.studio import with_contact

    view = View(options)
    values = options.of(IN_SETTINGS) | {"integrator": options.shown, "backfaces": options.backfaces or MUTED}
    settings = with_contact(settings_of(**values))
    baked = light_source(settings, options.bake, options.is_quick)
    scan_scene = ScanScene(scan, options, view.choice, layers, baked)
    scan_scene.auto_backfaces = options.backfaces is None  # a chosen value stays
    return view, settings, scan_scene


class ScanScene:
    """A scan with its lights. Raises ValueError for invalid options, before the file is read.

    Parameters
    ----------
    files : ScanFiles
    options : PictureOptions
    choice : ViewChoice
        How to view the scan.
    layers : bool
        Whether the background is part of the scene, as in layers. Images get it as a backdrop.
    baked : LightSource, optional
        Source of baked light; None: none is used.
    neutral : bool
        See `ScanMaterial`.

    Attributes
    ----------
    read : Points or None
        Points of a scan as read, once it has been built: its model may have other normals.
    auto_backfaces : bool
        Whether muted back faces are shown as front faces are where many are visible.
    """

    def __init__(
        self,
        files: ScanFiles,
        options: PictureOptions,
        choice: ViewChoice,
        layers: bool = False,
        baked: LightSource | None = None,
        neutral: bool = False,
    ) -> None:
        import pointray as pr

        self.files, self._options, self._surface = files, options, options.of(OF_SURFACE)
        self._choice, self._baked, self._layers = choice, baked, layers
        self._scan: Any = None  # the analysed model, unless it is in parts
        check_saved(files.files[0], self._surface == PLAIN and options.normals == AUTO)
        self.read: Points | None = None
        self.auto_backfaces = True
        self._unkept: tuple[Any, Any, list[str]] | None = None  # what `keep` stores
        self._lights = ScanLights(options.light, options.fill)
        self._material = ScanMaterial(options.material, options.color, options.color_by, neutral)
        self._scene = pr.Scene()
        self._background = background_of(options.background)
        self._scene.background = self._background  # checks it
        # A colour becomes the backdrop of an image, which the exposure does not change.
        if not layers and not isinstance(self._background, str):
            self._scene.background = None

    @property
    def inputs(self) -> dict[str, Any]:
        """Inputs of the scene, as JSON values."""
        baked = {} if self._baked is None else self._baked.inputs
        options = {**self._surface, **self._options.of(OF_SCENE), "background": self._options.background}
        options |= {"normals": self._options.normals, "auto_backfaces": self.auto_backfaces}
        return {**self.files.inputs, **options, **asdict(self._choice), **baked}

    @property
    def backdrop(self) -> Any:
        """Backdrop of the image, as `write_image` takes it."""
        from ..image.tone import GRADIENT, linear_to_srgb

        if self._options.background == AUTO:
            return GRADIENT
        if not isinstance(self._background, tuple):
            return None
        color = tuple(linear_to_srgb(np.array(self._background)).tolist())
        return color, color

    @property
    def legend(self) -> Any:
        """Attribute that colours the scan, with the range shown and the name that the user gave."""
        assert self._material.attribute is not None
        return replace(self._scene.shown_attributes[0], name=self._material.attribute.name)

    def build(self, progress: Progress) -> tuple[Any, Any, Any]:
        """Return the scene, its model, and the `Scan` with the automatic choices."""
        from ..auto_view.first_view import Scan

        self.files.check()
        model = self._load(progress)
        scan = in_background(lambda: Scan(model, self._choice))
        self._scene.add(model, material=self._material.build(model.points, scan.up))
        bounds = scan.bounds if scan.ignored else model.bounds
        if self._options.ground:
            self._scene.add(ground_under(bounds, scan.up))
        self._scene.lights = self._lights.make(bounds.mean(axis=0), scan.up, self._front(model, scan))
        self._scan = None if model.parts else scan
        return self._scene, model, scan

    def shown_with(self, settings: Any, camera: Any) -> Any:
        """Return the settings for images of the built scene.

        They are without baked light where it was not worth it, and without muted back faces where many are visible.
        """
        from ..auto_view.fronts import shows_backs
        from ..auto_view.studio import with_direct_light

        settings = with_direct_light(settings) if self._baked is None else settings
        may_change = self.auto_backfaces and settings.backfaces != SAME
        if may_change and (self._scan is None or shows_backs(self._scene, camera)):
            return replace(settings, backfaces=SAME)
        return settings

    def shadow(self, settings: Any) -> Any:
        """Return the contact shadow of the built scene; None if the scan does not stand.

        It needs the light of the studio and a backdrop.
        """
        from ..auto_view.contact import contact_shadow

        wanted = self._options.contact_shadow and not self._options.ground
        fits = wanted and settings.integrator in EXPOSED and self._lights.look == STUDIO
        if not fits or self.backdrop is None or self._layers or self._scan is None or not self._scan.stands:
            return None
        scan = self._scan
        key = next((light.direction for light in self._scene.lights if isinstance(light, SunLight)), None)
        return in_background(lambda: contact_shadow(self._scene, scan.positions, scan.up, key))

    def _front(self, model: Any, scan: Any) -> float | None:
        """Return the front of the key light, see `ScanLights.make`; rooms and models in parts are baked on request."""
        if self._baked is None:
            return None
        outlook = scan.natural_outlook
        if (outlook.within or model.parts) and self._baked.quick:
            self._baked = None
            return None
        return float(round(outlook.azimuth))  # independent of the options of the view

    @property
    def one_color(self) -> tuple[float, float, float] | None:
        """Linear colour that options give to all points, if they do."""
        return self._material.one_color

    @property
    def bakes(self) -> bool:
        """Whether light is baked."""
        return self._baked is not None and self._baked.file is None

    @property
    def may_level(self) -> bool:
        """Whether the model may get levels of detail: its surface is the default, and no file has light for it."""
        return self._surface == PLAIN and (self._baked is None or self._baked.file is None)

    def light(self, progress: Progress, note: str = FIRST) -> None:
        """Give the scene its baked light, if there is to be any, after `build` and after levels of detail are made.

        note : printed if the light is baked on request
        """
        if self._baked is not None:
            self._baked.light(self._scene, progress, note)

    def _load(self, progress: Progress) -> Any:
        """Return the model of a scan or of a saved model."""
        import pointray as pr

        from ..model.model_cache import built

        files, saved = self.files, self.files.saved
        progress.show("reading", 0.0)
        if saved is not None:
            return in_background(lambda: pr.Model.load(saved))
        entry = files.entry(normals=self._options.normals, **self._surface)
        found = entry and in_background(entry.load)
        if found is not None:
            found.levels = ()  # images must not depend on whether the model was cached
            self._material.build(found.points, self._choice.up)
            return found
        model, notes = built(lambda: self._built(progress))
        self._unkept = None if entry is None else (entry, model, notes)
        return model

    def keep(self, progress: Progress) -> None:
        """Store a newly built model in the cache, if it is in use."""
        if self._unkept is not None:
            entry, model, notes = self._unkept
            self._unkept = None

            def show(stage: str, share: float) -> None:
                progress.show("keeping the model for next time", share)

            in_background(lambda: entry.store(model, notes, show))

    def _built(self, progress: Progress) -> Any:
        """Return the model of a scan, read and built."""
        import pointray as pr

        from ..rendering.warmup import NORMALS, expect

        files = self.files
        points = self.read = in_background(lambda: files.read(progress.show))
        if points.normals is None or self._options.normals == "fit":
            expect(NORMALS)
        self._material.build(points, self._choice.up)  # raises ValueError for invalid options
        radii = radii_in(points)
        progress.show("normals", 0.0)
        try:
            trusty = in_background(lambda: select_normals(points, self._options.normals, progress=progress.show))
            return in_background(lambda: pr.Model(trusty, radii, **self._surface, progress=progress.show))
        except ValueError as error:
            raise ValueError(f"{files.name}: {as_option(error)}") from error


def ground_under(bounds: Any, up: tuple[float, float, float]) -> Any:
    """Return a plane under a box."""
    from ..scene.instances import Plane

    return Plane([low if u >= 0 else high for u, low, high in zip(up, *bounds, strict=True)], up)
