"""Settings of a bake."""

from __future__ import annotations

from dataclasses import dataclass

from ..base.arguments import check_positive, check_whole

MOST_LINKS = 4096
UNLIMITED_DEPTH = 1000  # bounces if there is no limit


@dataclass(frozen=True)
class BakeSettings:
    """Settings of `bake`, which computes the light that arrives at a scene's surfaces after all bounces.

    Patches, a subset of the splats and cells of planes, exchange light with each other.

    Parameters
    ----------
    links : int
        Rays that each patch sends to find where light arrives from, 1 to 4096. Where these are too few to reach
        `noise`, up to three times as many more are sent.
    max_depth : int, optional
        Maximum number of scattering events along a light path: 1 omits light reflected by surfaces. None for no limit.
    noise : float
        Target standard error of the irradiance, as a fraction of it.
    patches : int, optional
        Approximate number of patches on all instances of models together; planes get half as many more, and surfaces
        lit from behind count twice. Light is interpolated between patches. Default: half the number of splats, at
        least 32,768 and at most 1,048,576.
    memory : int, optional
        Maximum size of the result in bytes. Full light takes 16 bytes per splat and lit side of every instance, also
        for levels of detail. If that is too much, the light of some instances is coarser: 16 bytes for each patch, or
        for each 4th, 16th and so on, and 8 bytes per splat of the model, however many instances it has; see
        `Baked.levels`. Default: half of the available memory.
    albedo_scale : float
        Factor for the colours of points in light transport, above 0 and at most 1, because colours from photographs
        already contain shading. Images show colours unscaled.
    seed : int
        Seed of the random numbers.
    threads : int, optional
        Default: `POINTRAY_THREADS`, or else all. The light does not depend on it.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a value is out of its range.

    Examples
    --------
    >>> fine = pr.BakeSettings(links=128, noise=0.01)
    >>> fine.links, fine.max_depth
    (128, None)
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
            raise ValueError(f"albedo_scale must be at most 1, got {self.albedo_scale}")
        for name, least in (("max_depth", 0), ("patches", 64), ("memory", 1), ("threads", 1)):
            if getattr(self, name) is not None:
                most = UNLIMITED_DEPTH if name == "max_depth" else None
                checked[name] = check_whole(getattr(self, name), name, least, most, or_none=True)
        for name, value in checked.items():  # plain Python types: others would compile kernels again
            object.__setattr__(self, name, value)

    @property
    def depth(self) -> int:
        """Maximum number of scattering events along a light path; UNLIMITED_DEPTH if `max_depth` is None."""
        return UNLIMITED_DEPTH if self.max_depth is None else self.max_depth
