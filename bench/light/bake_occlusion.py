"""Ambient occlusion compared with libigl's, which traces a mesh.

libigl has two versions: with its own tree of boxes, and with Embree. Both weight all directions of the hemisphere
equally, not by the cosine; each is compared with many rays of the same distribution.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pointray as pr
from bench.light.bake_gather import gather, places_of_points, rms_error
from bench.light.bake_rows import Options, Row, at_least, at_most, plain_row
from bench.light.bake_scenes import solid

Floats = NDArray[np.float64]

PLACES, QUICK_PLACES = 2048, 512
SAMPLES, QUICK_SAMPLES = 4096, 1024  # rays of each reference at each place
ALBEDO = 0.5
MESH, QUICK_MESH = "meshes/stanford_dragon_mesh.ply", "meshes/stanford_bunny_mesh.ply"


def under_sky(model: pr.Model) -> pr.Scene:
    """A model under an even sky of radiance 1."""
    scene = pr.Scene()
    scene.add(model, material=pr.Diffuse(ALBEDO))
    scene.add_light(pr.EnvironmentLight())
    return scene


def bake_occlusion(model: pr.Model) -> tuple[pr.Scene, pr.Baked, float, int]:
    """The scene, the baked light, the seconds, and the number of rays."""
    scene = under_sky(model)
    begun = time.perf_counter()
    baked = pr.bake(scene, pr.BakeSettings(max_depth=1))
    spent = time.perf_counter() - begun
    return scene, baked, spent, sum(len(part.links) for part in baked._exchange.transport.links)


def error_of(scene: pr.Scene, baked: pr.Baked, options: Options) -> float:
    """Return the RMS error of baked occlusion relative to the mean, at random points with many reference rays."""
    count, samples = (QUICK_PLACES, QUICK_SAMPLES) if options.quick else (PLACES, SAMPLES)
    places = places_of_points(scene, 0, count)
    first, second = (gather(scene, places, samples, seed, depth=1)[:, 0] / ALBEDO for seed in (1, 2))
    return rms_error(baked.ambient_occlusion(0)[places.rows], first, second)


def occlusion(options: Options) -> list[Row]:
    """Seconds and error for the statue; rays a second and errors for a mesh and its vertices."""
    bake_occlusion(solid("sphere", 5000))
    scene, baked, spent, sent = bake_occlusion(solid("statue", options.points))
    what = f"occlusion of {options.points:,} points: "
    rows = [
        at_most(what + "error", error_of(scene, baked, options), 0.03),
        plain_row(what + "s", f"{spent:.1f} ({sent / options.points:.0f} rays a point)"),
    ]
    return [*rows, *_beside_igl(options)]


def _beside_igl(options: Options) -> list[Row]:
    path = options.models / (QUICK_MESH if options.quick else MESH)
    name = path.stem.split("_")[1]
    try:
        import igl
        import igl.embree
        import trimesh
    except ImportError as absent:
        return [plain_row("occlusion beside libigl", f"skipped: {absent}")]
    if not path.exists():
        return [plain_row("occlusion beside libigl", f"skipped: no {path}")]
    mesh = trimesh.load(path, process=False)
    vertices, faces = np.ascontiguousarray(mesh.vertices, float), np.ascontiguousarray(mesh.faces, np.int64)
    normals = np.ascontiguousarray(mesh.vertex_normals, float)
    model = pr.Model(pr.Points(vertices, normals, origin=(0, 0, 0)))
    scene, baked, spent, sent = bake_occlusion(model)
    mine, count = sent / spent, max(round(sent / len(vertices)), 1)
    error = error_of(scene, baked, options)
    what = f"occlusion of the {name}, {len(vertices):,} points: "
    rows = [plain_row(what + "baked", f"{mine / 1e6:.2f} M rays/s, {count} a point, error {error:.2%}")]
    peers: dict[str, Callable[..., Any]] = {"igl": igl.ambient_occlusion, "igl.embree": igl.embree.ambient_occlusion}
    for peer, function in peers.items():
        begun, used = time.perf_counter(), time.process_time()
        seen = 1.0 - function(vertices, faces, vertices, normals, count)
        spent, used = time.perf_counter() - begun, time.process_time() - used
        theirs = len(vertices) * count / spent
        off = _error_of_igl(function, (vertices, faces, normals), seen, options)
        note = f" ({theirs / 1e6:.2f} M rays/s, {used / spent:.1f} threads, error {off:.2%})"
        rows.append(at_least(f"{what}rays a second / {peer}'s", mine / theirs, 1.0, note=note))
    return rows


def _error_of_igl(
    function: Callable[..., Any], mesh: tuple[Floats, NDArray[np.int64], Floats], seen: Floats, options: Options
) -> float:
    """Return the error of libigl's occlusion at random vertices, compared with its own with many rays."""
    vertices, faces, normals = mesh
    count, samples = (QUICK_PLACES, QUICK_SAMPLES) if options.quick else (PLACES, SAMPLES)
    rows = np.random.default_rng(0).permutation(len(vertices))[:count]
    many = 1.0 - function(vertices, faces, vertices[rows], normals[rows], samples)
    return rms_error(seen[rows], many, many)
