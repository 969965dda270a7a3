"""`Settings`: parameters of rendering besides scene and camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..base.arguments import check_choice, check_flag, check_positive, check_whole
from ..base.choices import BACKFACES, FILTERS, INTEGRATORS, NOISY, SAME, number_of

PHONG, AO, PATH, NORMAL, DEPTH, COLOR, COST, BAKED = (
    number_of(INTEGRATORS, name) for name in ("phong", "ao", "path", "normal", "depth", "color", "cost", "baked")
)
MOST_SAMPLES = 65536
MOST_SKY_RAYS = 64
DEEPEST = 1000  # bounces of a path without a limit


@dataclass(frozen=True)
class Settings:
    """Rendering parameters besides scene and camera.

    Parameters
    ----------
    integrator : str
        "phong": direct light with hard shadows, mirrors and glass. "ao": ambient occlusion, without lights. "path":
        path tracing. "baked": direct light with sharp shadows, soft for area lights with several samples, and indirect
        light from `Scene.baked`. Or a value at the first hit: "normal" (world, -1 to 1 mapped to 0 to 1), "depth"
        (distance along the view, in a panorama from the eye), "color" (unlit), "cost" (red: nodes visited, green:
        leaves visited, blue: both / 64).
    spp : int
        Samples a pixel, 1 to 65,536; a single one goes through the centre of the pixel and of the lens. The maximum if
        `time_limit` or `noise` is given, where 1 stands for 65,536.
    max_depth : int, optional
        Maximum number of bounces of a path, 0 to 1000; 1: direct light only; None: 1000. For "phong" and "baked", the
        maximum number of successive mirrors and glass surfaces, at most 32.
    shadows : bool
        Whether direct light of "phong" and "baked" casts shadows.
    ao_distance : float, optional
        Length of the rays of "ao" and `sky_rays`, in world units; None: a fifth of the scene's diagonal.
    seed : int
        Seed of random numbers.
    threads : int, optional
        None: `POINTRAY_THREADS`, else all. The image does not depend on it.
    time_limit : float, optional
        Stop adding samples after this many seconds; at least one is taken.
    noise : float, optional
        Stop when the standard error of the pixels, root mean square, is below this fraction of the image's mean. It is
        estimated as for independent samples; as samples are stratified, the actual error is lower.
    denoise : bool
        Denoise "path" and "ao" with Intel's Open Image Denoise (`pip install 'pointray[denoise]'`), guided by albedo
        and normals.
    levels : bool
        Use levels of detail of models that have them (`Model.make_levels`), by distance.
    filter : str
        Pixel filter for several samples: "box" (1 pixel wide), "tent" (2 pixels wide), "gaussian" (standard deviation
        0.5 pixels, radius 1.5), "blackman-harris" (3 pixels wide). On a checkerboard finer than the pixels, the last
        leaves a third of the moire of the box (tent the same, gaussian a seventh), and edges are smooth. With 4 samples
        it has 20% more noise than the box (gaussian 39%, and blurred detail).
    sky_rays : int
        Rays a sample, 0 to 64, for contact shadows in "phong": the visible fraction of the sky within `ao_distance`. 0:
        light of the sky is not occluded.
    backfaces : {"same", "muted"}
        Back faces of models in "phong" and "baked". "same": shaded like front faces. "muted": desaturated, and lit by
        the sky or the headlight without shadows, so that holes of a scan are not black. Mirrors and glass are
        unchanged, and so is a scene lit by lamps only.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a value is invalid or out of its range.

    Examples
    --------
    >>> settings = pr.Settings("path", spp=16, max_depth=6)
    >>> settings.integrator, settings.spp, settings.filter
    ('path', 16, 'blackman-harris')
    """

    integrator: str = "phong"
    spp: int = 1
    max_depth: int | None = 4
    shadows: bool = True
    ao_distance: float | None = None
    seed: int = 0
    threads: int | None = None
    time_limit: float | None = None
    noise: float | None = None
    denoise: bool = False
    levels: bool = True
    filter: str = "blackman-harris"
    sky_rays: int = 0
    backfaces: str = SAME

    def __post_init__(self) -> None:
        checked: dict[str, Any] = {
            "integrator": check_choice(self.integrator, "integrator", INTEGRATORS),
            "filter": check_choice(self.filter, "filter", FILTERS),
            "backfaces": check_choice(self.backfaces, "backfaces", BACKFACES),
            "spp": check_whole(self.spp, "spp", 1, MOST_SAMPLES),
            "sky_rays": check_whole(self.sky_rays, "sky_rays", 0, MOST_SKY_RAYS),
            "seed": check_whole(self.seed, "seed", 0, 2**31 - 1),
        }
        for name in ("shadows", "denoise", "levels"):
            checked[name] = check_flag(getattr(self, name), name)
        if self.max_depth is not None:
            checked["max_depth"] = check_whole(self.max_depth, "max_depth", 0, DEEPEST, or_none=True)
        if self.threads is not None:
            checked["threads"] = check_whole(self.threads, "threads", 1, or_none=True)
        for name in ("ao_distance", "time_limit", "noise"):
            if getattr(self, name) is not None:
                checked[name] = check_positive(getattr(self, name), name, "a positive number, or None")
        for name, value in checked.items():  # Python's own types: others would compile kernels again
            object.__setattr__(self, name, value)

    @property
    def most(self) -> int:
        """Maximum number of samples a pixel: `spp`; or 65,536 if that is 1 and a limit of time or noise is set."""
        open_ended = self.spp == 1 and (self.time_limit is not None or self.noise is not None)
        return MOST_SAMPLES if open_ended else self.spp

    @property
    def denoised(self) -> bool:
        """Whether the image is denoised: if requested, and the integrator has noise ("ao" and "path")."""
        return self.denoise and self.integrator in NOISY

    @property
    def depth(self) -> int:
        """Maximum number of bounces, `max_depth`; 1000 if that is None."""
        return DEEPEST if self.max_depth is None else self.max_depth
