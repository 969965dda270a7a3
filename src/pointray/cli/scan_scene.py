"""The scene of a scan, from the options of `render`, `animate` and `bake`."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np

from ..auto_view import STUDIO
from ..auto_view.first_view import ViewChoice
from ..base.choices import AUTO, EXPOSED, MUTED
from ..cloud.normals.validation import select_normals
from ..cloud.points import Points
from ..surface.splats.radii import radii_in
from .baked_light import FIRST, LightSource, light_source
from .options import background_of, settings_of
from .picture_options import IN_SETTINGS, OF_SCENE, OF_SURFACE, PictureOptions
from .scan_files import ScanFiles, load_saved
from .scan_lights import ScanLights
from .scan_material import ScanMaterial
from .scan_surface import PLAIN, as_option, check_saved
from .views import View
from .waiting import Progress, in_background


def staged(scan: ScanFiles, options: PictureOptions, layers: bool = False) -> tuple[View, Any, ScanScene]:
    """Return camera (a View), Settings and ScanScene of a scan for the options of a command, before the scan is read.

    Raise ValueError if an option is invalid.

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
    """A scan with its lights, material, ground and background, from the options of a command. `build` makes the scene.

    Raises ValueError for invalid options, before the scan is read.

    Parameters
    ----------
    files : ScanFiles
    options : PictureOptions
    choice : ViewChoice
        Options of the view: up direction, side, angles and zoom.
    layers : bool
        Whether the result is layers for other programs: the background colour is then part of the scene. Otherwise it
        is put behind the image when that is written, and the exposure does not change it.
    baked : LightSource, optional
        Source of baked light; None: none is used.
    neutral : bool
        Whether points without colours are neutral grey instead of clay.

    Attributes
    ----------
    read : Points or None
        Points of a scan as read, once it has been built: its model may have other normals.
    auto_backfaces : bool
        Whether back faces are muted (desaturated) only if few are visible. False: an option decides.
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
        """All that the scene depends on, as JSON values: files, options and light.

        If it has changed, all frames of an interrupted animation are rendered again.
        """
        baked = {} if self._baked is None else self._baked.inputs
        options = {**self._surface, **self._options.of(OF_SCENE), "background": self._options.background}
        options |= {"normals": self._options.normals, "auto_backfaces": self.auto_backfaces}
        return {**self.files.inputs, **options, **asdict(self._choice), **baked}

    @property
    def backdrop(self) -> Any:
        """Colours at the top and bottom, sRGB, that `write_image` puts behind the image.

        None if the image is transparent or shows the environment.
        """
        from ..image.tone import GRADIENT, linear_to_srgb

        if self._options.background == AUTO:
            return GRADIENT
        if not isinstance(self._background, tuple):
            return None
        color = tuple(linear_to_srgb(np.array(self._background)).tolist())
        return color, color

    @property
    def legend(self) -> Any:
        """The Attribute that colours the scan, for a legend: with the range shown, and the name that the user typed."""
        assert self._material.attribute is not None
        return replace(self._scene.shown_attributes[0], name=self._material.attribute.name)

    def build(self, progress: Progress) -> tuple[Any, Any, Any]:
        """Read the scan, build or load its model and make the scene; return the scene, the Model and the `Scan`.

        The `Scan` has the up direction and the view direction that were chosen automatically.
        """
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
        """Return the settings for images of the built scene from a camera.

        Baked light becomes direct light where `build` turned baking off, as it does by default in rooms.
        Back faces are lit like front faces if many of them are visible, unless an option decides.
        """
        from ..auto_view.default_scene import with_visible_backs
        from ..auto_view.studio import with_direct_light

        settings = with_direct_light(settings) if self._baked is None else settings
        return (
            with_visible_backs(settings, self._scene, camera, self._scan is None) if self.auto_backfaces else settings
        )

    def shadow(self, settings: Any) -> Any:
        """Compute the shadow of a standing object on an invisible ground, for images of the built scene.

        Return None if the scan does not stand, an option excludes the shadow, the lights are not the default ones
        ("studio"), or the image has no background colour to draw it on.
        """
        from ..auto_view.default_scene import shadow_under

        wanted = self._options.contact_shadow and not self._options.ground
        fits = wanted and settings.integrator in EXPOSED and self._lights.look == STUDIO
        if not fits or self.backdrop is None or self._layers or self._scan is None or not self._scan.stands:
            return None
        scan = self._scan
        return in_background(lambda: shadow_under(self._scene, scan))

    def _front(self, model: Any, scan: Any) -> float | None:
        """Return the azimuth in degrees of the view for which the key light of the default lights is fixed.

        It is fixed if light is baked; None: it follows the camera. Indoor scans and models in parts are baked only on
        request: otherwise this method turns baking off.

        scan : the `auto_view.first_view.Scan` of the model, which knows its default view
        """
        from ..auto_view.default_scene import fixed_front

        if self._baked is None:
            return None
        front = fixed_front(scan, self._baked.quick, bool(model.parts))  # independent of the options of the view
        self._baked = self._baked if front is not None else None
        return front

    @property
    def one_color(self) -> tuple[float, float, float] | None:
        """Linear RGB of all points if options give them one colour, otherwise None."""
        return self._material.one_color

    @property
    def bakes(self) -> bool:
        """Whether light is baked, not read from a file."""
        return self._baked is not None and self._baked.file is None

    @property
    def may_level(self) -> bool:
        """Whether levels of detail may be added to the model.

        Its surface must be the default, and baked light must not come from a file, which has no light for them.
        """
        return self._surface == PLAIN and (self._baked is None or self._baked.file is None)

    def light(self, progress: Progress, note: str = FIRST) -> None:
        """Bake or read the light of the scene, if it has baked light, and add it to the scene.

        Call it after `build`, and after levels of detail are made. note : printed if the light is baked on request
        """
        if self._baked is not None:
            self._baked.light(self._scene, progress, note)

    def _load(self, progress: Progress) -> Any:
        """Return the model: a saved one, one from the cache, or built from the points of the scan."""

        from ..model.model_cache import built

        files, saved = self.files, self.files.saved
        progress.show("reading", 0.0)
        if saved is not None:
            return in_background(lambda: load_saved(saved, progress.show))
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
        """Store a newly built model in the cache on disk for the next start, if the cache is used."""
        if self._unkept is not None:
            entry, model, notes = self._unkept
            self._unkept = None

            def show(stage: str, share: float) -> None:
                progress.show("keeping the model for next time", share)

            in_background(lambda: entry.store(model, notes, show))

    def _built(self, progress: Progress) -> Any:
        """Read the points of the scan and build the model, with the normals that the options select."""
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
    """Return a `Plane` that a bounding box stands on. bounds : (2, 3), minimum and maximum; up : (3,), its normal"""
    from ..scene.instances import Plane

    return Plane([low if u >= 0 else high for u, low, high in zip(up, *bounds, strict=True)], up)
