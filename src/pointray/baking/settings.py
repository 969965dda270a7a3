"""How light is baked: everything that is not the scene."""

from __future__ import annotations

from dataclasses import dataclass

from ..base.arguments import check_positive, check_whole

MOST_LINKS = 4096
DEEPEST = 1000  # bounces without a limit


@dataclass(frozen=True)
class BakeSettings:
    """How light is baked.

    Parameters
    ----------
    links : int
        Rays that each patch sends to find from where light arrives, 1 to 4096. Where they are too few for `noise`,
        more are sent.
    max_depth : int, optional
        Scatterings along a path of light, as in `Settings`: 1 keeps the light of the sky only, None: no limit.
    noise : float
        The standard error of the irradiance that is aimed at, as a share of it.
    patches : int, optional
        At most so many surface elements of all instances together exchange light, and half as many of planes; those
        whose back is lit count twice. The light of splats between them is interpolated. None: a
        half of the splats, at least 32,768 and at most 1,048,576.
    memory : int, optional
        Bytes that the light may take, 16 for each splat and lit side of every instance, levels of detail included.
        Where that is too much the light of some instances is coarser: it takes 16 bytes for each patch, or for each
        4th, 16th and so on, and 8 for each splat of the model, however many instances it has; see `Baked.levels`.
        None: half of what is available.
    albedo_scale : float
        Factor for the colours of points, 0 to 1, as light meets them on its way: colours of photographs hold light
        already. Pictures show colours as they are.
    seed : int
        Of all that is left to chance.
    threads : int, optional
        None: `POINTRAY_THREADS`, else all. The light does not depend on it.
    """

    links: int = 48
    max_depth: int | None = None
    noise: float = 0.03
    patches: int | None = None
    memory: int | None = None
    albedo_scale: float = 1.0
    seed: int = 0
    threads: int | None = None

    def __post_init__(self) -> None:
        checked = {
            "links": check_whole(self.links, "links", 1, MOST_LINKS),
            "noise": check_positive(self.noise, "noise"),
            "albedo_scale": check_positive(self.albedo_scale, "albedo_scale"),
            "seed": check_whole(self.seed, "seed", 0, 2**31 - 1),
        }
        if checked["albedo_scale"] > 1.0:
            raise ValueError(f"albedo_scale must be at most 1, not {self.albedo_scale}")
        for name, least in (("max_depth", 0), ("patches", 64), ("memory", 1), ("threads", 1)):
            if getattr(self, name) is not None:
                most = DEEPEST if name == "max_depth" else None
                checked[name] = check_whole(getattr(self, name), name, least, most, or_none=True)
        for name, value in checked.items():  # Python's own types: another one would compile a kernel anew
            object.__setattr__(self, name, value)

    @property
    def depth(self) -> int:
        """Scatterings at most."""
        return DEEPEST if self.max_depth is None else self.max_depth
