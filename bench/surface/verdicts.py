"""Verdicts on the surface: each requirement is met, NOT met, or not measured in this run."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from bench.helpers.measure import AUTO, WIDE, Row
from bench.helpers.truth import MESHES

Rows = list[Row]
SOLID = ("sphere", "torus", "statue")
MANY = 10_000_000  # rays


class Verdict(NamedTuple):
    """A requirement in words, the measured figure, and whether it is met (None if not measured in this run)."""

    demand: str
    seen: str
    met: bool | None


def verdicts(rows: Rows, surface: str) -> list[Verdict]:
    """Return the verdicts on all requirements, from the rows of the default surface."""
    ours = [r for r in rows if (r.surface, r.radii, r.samples, r.refine) == (surface, AUTO, 4, 1)]
    plain = [r for r in ours if r.noise == 0]
    return [
        *_holes(ours, plain),
        _phantoms(ours),
        *_errors(rows, plain, ("sphere", "torus"), 100_000, (0.005, 0.5), (10, 5)),
        *_errors(rows, plain, ("statue",), 1_000_000, (0.03, 2.0), (2, 2)),
        *_supports(rows, plain),
    ]


def _holes(ours: Rows, plain: Rows) -> list[Verdict]:
    solid = [r for r in plain if r.shape in SOLID]
    found: list[Verdict] = []
    for attribute, what in (("missed", "miss"), ("holes", "miss or reach the far wall")):
        rays, lost = sum(r.rays for r in solid), sum(getattr(r, attribute) for r in solid)
        demand = f"no ray through sphere, torus, statue (no noise) may {what}"
        worst = _worst(solid, lambda r, a=attribute: getattr(r, a) / r.rays)
        seen = f"{lost:,} of {rays:,} rays{worst if lost else ''}"
        if solid and not lost and rays < MANY:
            seen += f", {MANY:,} required (--full)"
        found.append(Verdict(demand, seen, lost == 0 if solid else None))
        for some, where in (
            ([r for r in plain if r.shape in MESHES], "meshes"),
            ([r for r in ours if r.noise == 0.1], "0.1 h of noise"),
        ):
            share = lambda r, a=attribute: getattr(r, a) / r.rays  # noqa: E731
            found.append(_limit(f"{where}: at most 1 in 100,000 rays may {what}", some, share, 1e-5))
    return found


def _phantoms(ours: Rows) -> Verdict:
    some = [r for r in ours if r.noise <= 0.1 and r.hits]
    return _limit("phantoms, up to 0.1 h of noise: at most 1 in 10,000 hits", some, lambda r: r.phantoms / r.hits, 1e-4)


def _errors(
    rows: Rows, plain: Rows, shapes: tuple[str, ...], n: int, most: tuple[float, float], times: tuple[float, float]
) -> list[Verdict]:
    some = [r for r in plain if r.shape in shapes and r.n == n and r.sampling == "even"]
    where = f"{' and '.join(shapes)}, {n:,} even points"
    discs = {(r.shape, r.rays): r for r in rows if (r.surface, r.noise, r.n, r.sampling) == ("disc", 0, n, "even")}
    found = []
    for attribute, unit, limit, factor in (
        ("depth_rms", "h", most[0], times[0]),
        ("normal_mean", "degrees", most[1], times[1]),
    ):
        name = attribute.split("_")[0]
        error = lambda r, a=attribute: getattr(r, a)  # noqa: E731
        found.append(_limit(f"{where}: {name} within {limit} {unit}", some, error, limit))
        beside = [r for r in some if (r.shape, r.rays) in discs]
        gain = lambda r, e=error: e(discs[r.shape, r.rays]) / max(e(r), 1e-12)  # noqa: E731
        found.append(_least(f"{where}: {name} {factor:g} times better than discs", beside, gain, factor))
    return found


def _supports(rows: Rows, plain: Rows) -> list[Verdict]:
    wide = {_cloud(r): r for r in rows if r.radii == WIDE}
    pairs = [r for r in plain if _cloud(r) in wide]
    fewer = "references a point: at most half of those with 1.25 x the 8th neighbour's distance"
    faster = "frame rate: at least 1.1 times that with 1.25 x the 8th neighbour's distance"
    return [
        _limit("splats over a surface point, mean: at most 8", plain, lambda r: r.overlap, 8),
        _limit(fewer, pairs, lambda r: r.references / wide[_cloud(r)].references, 0.5),
        _least(faster, pairs, lambda r: wide[_cloud(r)].ms / r.ms, 1.1),
    ]


def _cloud(r: Row) -> tuple[object, ...]:
    return r.shape, r.sampling, r.n, r.noise, r.surface, r.samples, r.refine, r.rays


def _limit(demand: str, rows: Rows, figure: Callable[[Row], float], most: float) -> Verdict:
    if not rows:
        return Verdict(demand, "", None)
    worst = max(rows, key=figure)
    return Verdict(demand, f"{figure(worst):.3g}{_worst(rows, figure)}", figure(worst) <= most)


def _least(demand: str, rows: Rows, figure: Callable[[Row], float], least: float) -> Verdict:
    if not rows:
        return Verdict(demand, "", None)
    worst = min(rows, key=figure)
    return Verdict(demand, f"{figure(worst):.3g}{_worst(rows, lambda r: -figure(r))}", figure(worst) >= least)


def _worst(rows: Rows, figure: Callable[[Row], float]) -> str:
    """The cloud that the worst figure is from."""
    if len(rows) < 2:
        return ""
    r = max(rows, key=figure)
    noise = f", {r.noise} h of noise" if r.noise else ""
    return f" (worst of {len(rows)}: {r.shape}, {r.n:,} {r.sampling}{noise})"
