"""How a picture is made: everything that is neither scene nor camera."""

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
DEEPEST = 1000  # scatterings of a path without limit


@dataclass(frozen=True)
class Settings:
    """How a picture is made.

    Parameters
    ----------
    integrator : str
        "phong": direct light, hard shadows, mirrors and glass. "ao": ambient occlusion, no light needed. "path": all
        light there is, with noise that falls as samples grow. "baked": all light at once, direct light with sharp
        shadows, the rest as `Scene.baked` keeps it; more samples make shadows of large lights soft. Or what
        is at the first hit: "normal" (world, -1 to 1
        shown as 0 to 1), "depth" (distance along the view, in a panorama from the eye), "color" (unlit), "cost" (red:
        nodes, green: leaves visited, blue: both / 64).
    spp : int
        Samples a pixel; 1 goes through the middle of the pixel and of the lens. Where `time_limit` or `noise` may end
        the work earlier it is the most; 1 then stands for no such limit (65,536).
    max_depth : int, optional
        Scatterings along a path, 1: direct light only, None: no limit. For "phong", the mirrors and panes one behind
        the other, at most 32.
    shadows : bool
        Of "phong".
    ao_distance : float, optional
        How far "ao" and `sky_rays` look, in the world's units; None: a fifth of the scene's diagonal.
    seed : int
        Of all that is left to chance.
    threads : int, optional
        None: `POINTRAY_THREADS`, else all. The picture does not depend on it.
    time_limit : float, optional
        Seconds after which no more samples are begun; there is at least one.
    noise : float, optional
        Stop once the standard error of the pixels, root mean square, is below this share of the picture's mean. It is
        told from the samples' differences (they are better spread than at random: it is less than told).
    denoise : bool
        Take the noise that is left out of "path" and "ao": Intel's Open Image Denoise (`pip install
        'pointray[denoise]'`), told the surfaces' colours and normals.
    levels : bool
        Take models that have levels of detail (`Model.make_levels`) as coarse as their distance allows.
    filter : str
        How pixels are made of their samples, if there are several: "box" (the pixel itself), "tent" (2 pixels wide),
        "gaussian" (standard deviation 0.5 pixels, ends 1.5 from the middle), "blackman-harris" (3 pixels wide). On a
        checkerboard too fine for the pixels the last leaves a third of the box's moire (tent the same, gaussian a
        seventh), and edges are smooth where the box leaves steps; 4 samples have 20% more noise than in a box
        (gaussian 39%, and blurred detail).
    sky_rays : int
        Of "phong": rays a sample, 0 to 64, that find how much of the sky a surface point sees, no farther than
        `ao_distance`: contact shadows. 0: all of it, nothing is in the way of its light.
    backfaces : {"same", "muted"}
        Of "phong" and "baked": how the inner side of models is shown, from which normals point away. "same": by the
        light that arrives there. "muted": greyer, and lit by the sky or the headlight without shadows, so that holes of
        a scan are not black. Mirrors and glass stay as they are, and so does everything if only lamps give light.
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
        for name, value in checked.items():  # Python's own types: another one would compile a kernel anew
            object.__setattr__(self, name, value)

    @property
    def most(self) -> int:
        """Samples a pixel at most."""
        open_ended = self.spp == 1 and (self.time_limit is not None or self.noise is not None)
        return MOST_SAMPLES if open_ended else self.spp

    @property
    def denoised(self) -> bool:
        """Whether noise is taken out: where it is asked for, and there is any."""
        return self.denoise and self.integrator in NOISY

    @property
    def depth(self) -> int:
        """Scatterings at most."""
        return DEEPEST if self.max_depth is None else self.max_depth
