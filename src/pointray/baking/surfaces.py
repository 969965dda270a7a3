"""Surfaces of a scene, divided into patches that exchange light."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles, Flags, Floats, Rows
from ..base.progress import Progress, report_progress
from ..engine.jit import run
from ..engine.kernels import records as rec
from ..engine.kernels.records import World
from ..scene.world import Snapshot
from ..surface.trace.cast import closest_hits
from .gather import TARGET, Targets
from .patches import NEAR, PIECE, PatchSet, choose_patches
from .planes import Grid, fit_grid, grid_colors, grid_positions
from .reflectance import find_reflectances

PLANES_SHARE = 0.5  # patches of planes, as a fraction of the number of patches of models
LEAST_EDGE, MOST_EDGE = 32, 256  # cells along each side of a plane's grid
LEAST_PATCHES = 256  # of an instance, unless there are too many instances
BRIGHTEST = 0.9  # limit for points' colours: photographs contain shading, and white walls would never get dark
# Distances, in radii, from a splat to the start of the ray that finds the surface. The smaller ones are tried for
# splats with another surface close by, such as where a ball touches the ground.
LIFTS = (0.75, 0.2, 0.05)
TURNED = 0.3  # smallest cosine between a splat's normal and its surface; below it another surface was hit


class BakeSurface(NamedTuple):
    """Patches of one instance, shared by its front and back. A patch represents the surface around it.

    instance : row of the instance
    patches : splats of a model (`PatchSet`) or cells of a plane (`Grid`)
    positions : (m, 3) float64, on the surface, world
    normals : (m, 3) float32, unit, of the front, world
    albedo, emitted : (m, 3) float32, reflected fraction of light, and emitted radiance
    lost : (m,) bool, True where no surface was found
    margins : (m,) float32, distance above the surface at which a patch's rays start, in world units: the noise that
        denoising removed there, whose remains could block the rays
    """

    instance: int
    patches: PatchSet | Grid
    positions: Doubles
    normals: Floats
    albedo: Floats
    emitted: Floats
    lost: Flags
    margins: Floats


def find_surfaces(
    scene: Snapshot, most: int, albedo_scale: float, progress: Progress | None = None
) -> list[BakeSurface]:
    """Choose the patches of a scene and compute their geometry and colours; return those of each instance, in order.

    most : approximate number of patches on all instances of models; planes get about half as many more
    albedo_scale : factor for the colours of points in the albedo of patches
    """
    world = scene.world
    records = world.instances.reshape(-1, rec.INSTANCE)
    counts, edge = _shares(scene, most)
    sets = []
    for k, (model, count) in enumerate(zip(scene.models, counts, strict=True)):
        sets.append(choose_patches([model.tree, *(level.tree for level in model.levels)], count))
        report_progress(progress, (k + 1) / len(counts))
    bounds, surfaces = around(scene), []
    for k, record in enumerate(records):
        if record[rec.KIND] == rec.MODEL:
            found = sets[int(record[rec.SHAPE_ROW])]
            patches: PatchSet | Grid = found
            positions, normals, own, lost = _all_on_surface(world, k, found)
            margins = _margins(scene.models[int(record[rec.SHAPE_ROW])].tree.noise, found) / _model_scale(
                record, normals
            )
        else:
            plane = _plane_of(world, record)
            patches = fit_grid(plane, bounds, edge)
            positions = grid_positions(plane, patches)
            own = grid_colors(plane, patches).astype(np.float32)
            normals = np.broadcast_to(plane[3:6], positions.shape).astype(np.float32)
            lost, margins = np.zeros(len(positions), np.bool_), np.zeros(len(positions), np.float32)
        dark = np.zeros(own.shape, np.float32)
        surfaces.append(BakeSurface(k, patches, positions, normals, own, dark, lost, margins))
    return _shaded(scene, surfaces, albedo_scale)


def _margins(noise: Floats, patches: PatchSet) -> Floats:
    """Return the noise that denoising removed at each patch, (m,) in model units, by which its rays are offset.

    noise : (blocks,), standard deviation; empty if the points were not denoised
    """
    out = np.zeros(len(patches.positions), np.float32)
    if noise.size:
        out[patches.blends[0].patch_of] = np.repeat(noise, 4)
    return out


def _model_scale(record: Doubles, normals: Floats) -> Floats:
    """Return how many units of an instance's model one world unit is, along each of m world normals, (m,).

    record : the instance, as in `World.instances`
    """
    to_model = record[rec.TO_MODEL :][:12].reshape(3, 4)[:, :3]
    return np.maximum(np.linalg.norm(normals @ to_model.T, axis=1), 1e-30).astype(np.float32)


def with_materials(scene: Snapshot, surfaces: list[BakeSurface], albedo_scale: float) -> list[BakeSurface]:
    """Return the same surfaces with albedo and emission of the scene's current materials and colours.

    albedo_scale : factor for the colours of points
    """
    records = scene.world.instances.reshape(-1, rec.INSTANCE)
    out = []
    for surface in surfaces:
        if isinstance(surface.patches, Grid):
            own = grid_colors(_plane_of(scene.world, records[surface.instance]), surface.patches).astype(np.float32)
        else:
            own = _all_on_surface(scene.world, surface.instance, surface.patches)[2]
        out.append(surface._replace(albedo=own))
    return _shaded(scene, out, albedo_scale)


def with_levels(scene: Snapshot, surfaces: list[BakeSurface]) -> list[BakeSurface]:
    """Return the same surfaces with light interpolated to the splats of the models' current levels of detail."""
    records, sets, out = scene.world.instances.reshape(-1, rec.INSTANCE), {}, []
    for surface in surfaces:
        if not isinstance(surface.patches, Grid):
            row, count = int(records[surface.instance, rec.SHAPE_ROW]), len(surface.positions)
            if row not in sets:  # gives the same patches: they depend only on the model's tree and their number
                model = scene.models[row]
                sets[row] = choose_patches([model.tree, *(level.tree for level in model.levels)], count)
            surface = surface._replace(patches=sets[row])
        out.append(surface)
    return out


def _plane_of(world: World, record: Doubles) -> Doubles:
    return world.planes[int(record[rec.SHAPE_ROW]) * rec.PLANE_SIZE :][: rec.PLANE_SIZE]


def _shaded(scene: Snapshot, surfaces: list[BakeSurface], albedo_scale: float) -> list[BakeSurface]:
    """Return the same surfaces with albedo and emission of patches computed from the materials of their instances.

    surfaces : with the points' or the plane's own colours in `albedo`; albedo_scale : factor for the colours of points
    """
    world = scene.world
    records = world.instances.reshape(-1, rec.INSTANCE)
    reflectances = np.zeros(world.materials.size // rec.MATERIAL_SIZE * 2)
    run(find_reflectances, len(reflectances) // 2, world, reflectances)
    out = []
    for surface in surfaces:
        which = int(records[surface.instance, rec.MATERIAL])
        material, own = world.materials.reshape(-1, rec.MATERIAL_SIZE)[which], surface.albedo
        if not isinstance(surface.patches, Grid):
            own = np.minimum(own, np.float32(BRIGHTEST)) * np.float32(albedo_scale)
        color = (
            own
            if material[rec.OWN_COLOR]
            else np.broadcast_to(material[rec.BASE_COLOR : rec.BASE_COLOR + 3], own.shape)
        )
        black, more = reflectances[2 * which :][:2]
        emitted = np.zeros(own.shape, np.float32)
        if material[rec.MATERIAL_KIND] == rec.EMISSIVE:
            emitted[:] = material[rec.EMITTED : rec.EMITTED + 3]
        out.append(surface._replace(albedo=(black + more * color).astype(np.float32), emitted=emitted))
    return out


def _shares(scene: Snapshot, most: int) -> tuple[list[int], int]:
    """Return (number of patches for each model, number of cells along each side of a plane's grid).

    most : approximate number of patches on all instances of models
    """
    records = scene.world.instances.reshape(-1, rec.INSTANCE)
    planes = int((records[:, rec.KIND] != rec.MODEL).sum())
    edge = int(np.clip(np.sqrt(most * PLANES_SHARE / max(planes, 1)), LEAST_EDGE, MOST_EDGE))
    edge -= edge % 2  # records are read four at a time
    copies = np.bincount(
        records[records[:, rec.KIND] == rec.MODEL, rec.SHAPE_ROW].astype(int), minlength=len(scene.models)
    )
    splats = np.array([len(model.points) for model in scene.models])
    share = min(1.0, most / max(int((copies * splats).sum()), 1))
    least = min(LEAST_PATCHES, max(most // max(int(copies.sum()), 1), 1))
    return [max(int(n * share), min(int(n), least)) for n in splats], edge


def coarser(surfaces: list[BakeSurface], most: int) -> list[BakeSurface]:
    """Reduce each surface to at most `most` patches, every k-th of them, for a quick rough solution.

    Patches of models then have no neighbours, over which noise is averaged.
    """
    out = []
    for surface in surfaces:
        if isinstance(surface.patches, Grid):
            step = max(-(-surface.patches.edge // math.isqrt(most)), 1)
            edge = surface.patches.edge
            rows = np.arange(edge * edge).reshape(edge, edge)[step // 2 :: step, step // 2 :: step]
            out.append(_selected(surface, rows.reshape(-1), surface.patches._replace(edge=len(rows))))
            continue
        step = max(-(-len(surface.positions) // most), 1)
        rows = np.arange(len(surface.positions))[step // 2 :: step]
        blend = surface.patches.blends[0]
        patch_of = np.minimum(blend.patch_of // step, len(rows) - 1)
        none = np.full((len(rows), NEAR), -1, np.int32)
        patches = surface.patches._replace(near=none, blends=[blend._replace(patch_of=patch_of)])
        out.append(_selected(surface, rows, patches))
    return out


def _selected(surface: BakeSurface, rows: Rows, patches: PatchSet | Grid) -> BakeSurface:
    """Return a surface with only some of its patches.

    rows : (m,) indices of the patches to keep; patches : description of these, the result's field `patches`
    """
    arrays = [getattr(surface, name)[rows] for name in ("positions", "normals", "albedo", "emitted", "lost", "margins")]
    return BakeSurface(surface.instance, patches, *arrays)


def around(scene: Snapshot) -> Doubles:
    """Return the box around models and lights with a position, (2, 3); -1 to 1 if there are only planes and suns."""
    world = scene.world
    boxes = scene.boxes[world.instances.reshape(-1, rec.INSTANCE)[:, rec.KIND] == rec.MODEL].reshape(-1, 2, 3)
    lights = world.lights.reshape(-1, rec.LIGHT)
    lights = lights[lights[:, rec.LIGHT_KIND] != rec.SUN_LIGHT]
    middles = lights[:, rec.LIGHT_POSITION : rec.LIGHT_POSITION + 3]
    low, high = np.concatenate([boxes[:, 0], middles]), np.concatenate([boxes[:, 1], middles])
    return np.stack([low.min(axis=0), high.max(axis=0)]) if len(low) else np.array([[-1.0] * 3, [1.0] * 3])


def _all_on_surface(world: World, row: int, patches: PatchSet) -> tuple[Doubles, Floats, Floats, Flags]:
    """Project the patches of an instance onto its surface, PIECE of them at a time, to limit the memory of the rays.

    row : of the instance

    Returns
    -------
    (m, 3) float64
        World positions.
    (m, 3) float32
        Unit world normals.
    (m, 3) float32
        Colours of the surface.
    (m,) bool
        True where no surface was found; position and normal are then those of the splat.
    """
    m = len(patches.positions)
    out = np.empty((m, 3)), np.empty((m, 3), np.float32), np.empty((m, 3), np.float32), np.empty(m, np.bool_)
    for first in range(0, m, PIECE):
        span = slice(first, first + PIECE)
        arrays = {name: getattr(patches, name)[span] for name in ("positions", "normals", "radii")}
        found: tuple[NDArray[Any], ...] = _on_surface(world, row, patches._replace(**arrays))
        for k in range(len(out)):
            out[k][span] = found[k]
    return out


def _on_surface(world: World, row: int, patches: PatchSet) -> tuple[Doubles, Floats, Doubles, Flags]:
    """Project the patches of an instance onto its surface, with rays from a little above each patch along its normal.

    row : of the instance

    Returns
    -------
    (m, 3) float64
        World positions.
    (m, 3) float32
        Unit world normals.
    (m, 3) float64
        Colours of the surface.
    (m,) bool
        True where no surface was found; position and normal are then those of the splat.
    """
    to_model = world.instances[row * rec.INSTANCE + rec.TO_MODEL :][:12].reshape(3, 4)
    to_world = np.linalg.inv(to_model[:, :3])
    splats = (patches.positions - to_model[:, 3]) @ to_world.T
    normals = patches.normals @ to_model[:, :3]
    normals = (normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)).astype(np.float32)
    positions, colors, lost = splats.copy(), np.full(splats.shape, 0.5), np.ones(len(splats), np.bool_)
    for share in LIFTS:
        rows = np.flatnonzero(lost)
        lift = (patches.normals[rows] * (share * patches.radii[rows, None])) @ to_world.T
        limits = np.tile([0.0, 2.0], (len(rows), 1))
        rays = np.ascontiguousarray(splats[rows] + lift), np.ascontiguousarray(-lift), limits
        hits = closest_hits(world, (len(rows),), *rays)
        good = (hits["instance"] == row) & (np.einsum("ij,ij->i", normals[rows], hits["normal"]) >= TURNED)
        found = rows[good]
        positions[found], normals[found] = hits["position"][good], hits["normal"][good]
        colors[found], lost[found] = hits["color"][good], False
    return positions, normals, colors, lost


def find_targets(surfaces: list[BakeSurface], firsts: dict[tuple[int, int], int]) -> Targets:
    """Return the tables that map a ray's hit to the patch that represents it.

    firsts : index of the first patch of each lit side, by row of the instance and sign (1 front, -1 back); other sides
        are dark
    """
    rows = np.zeros((len(surfaces), TARGET), np.int64)
    frames = np.zeros((len(surfaces), rec.BAKED_FRAME))
    tables: list[NDArray[np.int32]] = []
    begins: dict[int, int] = {}
    end = 0
    for surface in surfaces:
        k = surface.instance
        rows[k, :2] = firsts.get((k, 1), -1), firsts.get((k, -1), -1)
        if isinstance(surface.patches, Grid):
            frames[k, :4] = *surface.patches.middle, surface.patches.half, surface.patches.edge
            continue
        patch_of, model = surface.patches.blends[0].patch_of, id(surface.patches.blends[0].around)
        if model not in begins:
            begins[model] = end
            tables.append(patch_of)
            end += len(patch_of)
        rows[k, 2] = begins[model]
    patch_of = tables[0] if len(tables) == 1 else np.concatenate([*tables, np.zeros(0, np.int32)])
    return Targets(rows.reshape(-1), patch_of, frames.reshape(-1))
