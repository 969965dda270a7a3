"""Compare the speed of pointray and Mitsuba 3: the same splats as Mitsuba's `ellipsoids`, in the same light.

`beside_mitsuba.py --speed` runs it. Both render two pictures of the statue from afar, in turn. The first has paths of 4
bounces under even light from all around (million samples a second). The second has direct light from a point with one
shadow ray (milliseconds a frame); pointray renders it with all points and in the level of detail that fits. A ratio
over 1 means that pointray is faster. It counts only if Mitsuba's depths are those of the discs.

Mitsuba intersects a ray and a disc in float32, relative to the ray's far origin, and starts rays some 1e-4 away from a
surface. The scene is enlarged and the discs have some height, so that nearly all depths agree with those of flat discs.
With a million points, 92.0, 96.6, 97.0 and 97.0% of the depths agree if the scene is enlarged by 1e3, 1e4, 1e5 and 1e6.
(With 20,000 points, 2% agree without enlarging, and 99.5% if enlarged by 1e3.) With a height of 0.03 radii 97.1% agree,
with 0.01 96.3%, with 0.3 94.6%. The others lie in front as often as behind.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from copy import copy
from typing import Any

import mitsuba as mi
import numpy as np

import pointray as pr
from bench.light.mitsuba_child import describe_exit, in_child
from bench.light.mitsuba_pairs import Floats, diffuse, rgb
from bench.light.mitsuba_scenes import their_camera
from bench.tracing.embree import alternate
from pointray.cli.benchmark.views import far_view

ENLARGED = 1e5
HEIGHT = 0.03  # height of an ellipsoid, in radii
PAUSE = 0.2  # seconds: Mitsuba's threads go on spinning for some milliseconds after a picture
AGREE = 0.97  # of the rays that hit both, the share whose depths must agree within a radius; no setting gave more
BOUNCES = 4
GREY = 0.5


def rotations(normals: Floats) -> Floats:
    """Quaternions (n, 4), x y z w, that take z to unit normals."""
    out = np.stack([-normals[:, 1], normals[:, 0], np.zeros(len(normals)), 1 + normals[:, 2]], axis=1)
    out[normals[:, 2] < -1 + 1e-6] = 1.0, 0.0, 0.0, 0.0
    return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))


def splats(model: pr.Model) -> dict[str, Any]:
    """The model's splats as a shape of Mitsuba's."""
    normals = model.points.normals
    assert normals is not None
    shapes = {
        "centers": ENLARGED * model.points.positions,
        "scales": ENLARGED * model.radii[:, None] * (1.0, 1.0, HEIGHT),
        "quaternions": rotations(normals.astype(np.float64)),
    }
    tensors = {name: mi.TensorXf(np.asarray(values, np.float32)) for name, values in shapes.items()}
    ends = {"extent": 1.0, "extent_adaptive_clamping": False}
    return {"type": "ellipsoids", **tensors, **ends, "bsdf": diffuse(GREY)}


def enlarged(camera: pr.Camera) -> pr.Camera:
    """The camera that sees Mitsuba's enlarged scene as `camera` sees ours."""
    eye, target = (ENLARGED * np.asarray(point, float) for point in (camera.eye, camera.target))
    return pr.Camera.look_at(eye, target, camera.up, camera.fov, camera.size)


def agreement(model: pr.Model, camera: pr.Camera) -> float:
    """Share of the rays that hit both whose depth at the ellipsoids is within a radius of that at flat discs."""
    flat = pr.Model(model.points, model.radii, surface="disc")
    scene = mi.load_dict({"type": "scene", "model": splats(model)})
    hits = our_scene(flat, None).intersect(*camera.rays())
    rays = [np.asarray(part, np.float32).reshape(-1, 3).T for part in enlarged(camera).rays()]
    found = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(rays[0]), mi.Vector3f(rays[1])))
    t = np.array(found.t).reshape(hits.t.shape) / ENLARGED
    both = np.isfinite(t) & np.isfinite(hits.t)
    return float((np.abs(t[both] - hits.t[both]) < model.radii[hits.point[both]]).mean())


def our_scene(model: pr.Model, light: Any) -> pr.Scene:
    """The model, grey."""
    scene = pr.Scene()
    scene.add(model, material=pr.Diffuse(GREY))
    if light is not None:
        scene.add_light(light)
    return scene


def pictures(
    model: pr.Model, camera: pr.Camera, spp: int, beside: bool = True
) -> dict[str, dict[str, Callable[[], Any]]]:
    """The timed calls: for each picture one by each renderer. beside : whether Mitsuba renders too"""
    low, high = model.bounds
    position = (low + high) / 2 + np.linalg.norm(high - low) * np.array([0.6, -0.8, 1.0])
    strength = 10.0 * float(np.linalg.norm(high - low)) ** 2
    theirs = {
        "path": {"type": "constant", "radiance": rgb(1.0)},
        "lit": {"type": "point", "position": (ENLARGED * position).tolist(), "intensity": rgb(strength * ENLARGED**2)},
    }
    ours = {"path": pr.EnvironmentLight(1.0), "lit": pr.PointLight(position, strength)}
    integrators = {
        "path": {"type": "path", "max_depth": BOUNCES + 1, "rr_depth": 10_000, "hide_emitters": True},
        "lit": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
    }
    settings = {"path": pr.Settings("path", spp, BOUNCES, filter="box"), "lit": pr.Settings("phong")}
    out: dict[str, dict[str, Callable[[], Any]]] = {}
    for name in ours:
        out[name] = {"pointray": _ours(our_scene(model, ours[name]), camera, settings[name])}
        if beside:
            scene = mi.load_dict({"type": "scene", "model": splats(model), "light": theirs[name]})
            sensor = their_camera(enlarged(camera), settings[name].spp)
            out[name]["mitsuba"] = _theirs(scene, sensor, mi.load_dict(integrators[name]))
    out["lit"]["pointray, levels of detail"] = _ours(our_scene(leveled(model), ours["lit"]), camera, settings["lit"])
    return out


def leveled(model: pr.Model) -> pr.Model:
    """The same model with levels of detail."""
    other = copy(model)
    other.make_levels()
    return other


def _ours(scene: pr.Scene, camera: pr.Camera, settings: pr.Settings) -> Callable[[], Any]:
    return lambda: pr.render(scene, camera, settings)


def _theirs(scene: Any, sensor: Any, integrator: Any) -> Callable[[], Any]:
    return lambda: np.array(mi.render(scene, sensor=sensor, integrator=integrator))


def speed(points: int, size: int, runs: int, spp: int, beside: Callable[..., None] | None = None) -> None:
    """Print the rows; only pointray's if Mitsuba ends its process. beside : what the child does"""
    ended = in_child(beside or speed_beside, points, size, runs, spp)
    if ended is not None:
        print(describe_exit(ended), "pointray alone:", flush=True)
        speed_alone(points, size, runs, spp)


def speed_beside(points: int, size: int, runs: int, spp: int) -> None:
    """Print the rows of both."""
    mi.set_variant("llvm_ad_rgb")
    warnings.simplefilter("ignore")
    model, camera = _seen(points, size)
    agree = agreement(model, camera)
    print(f"statue: {points:,} points, {size}x{size}; {agree:.1%} of Mitsuba's depths are correct to within a radius")
    for name, calls in pictures(model, camera, spp).items():
        light = {who: float(call()[..., :3].mean(dtype=np.float64)) for who, call in calls.items()}
        seconds = alternate(calls, runs, PAUSE)
        for who, spent in seconds.items():
            ratio = seconds["mitsuba"] / spent
            same = f"mean radiance of Mitsuba's / this {light['mitsuba'] / light[who]:.3f}"
            verdict = f"{ratio:.2f}" if agree >= AGREE else "invalid: its depths are wrong"
            figure = _figure(name, spent, size * size * spp)
            print(f"{name}: {who} {figure}, Mitsuba's time / this {verdict} ({same})")


def speed_alone(points: int, size: int, runs: int, spp: int) -> None:
    """Print pointray's rows."""
    model, camera = _seen(points, size)
    print(f"statue: {points:,} points, {size}x{size}")
    for name, calls in pictures(model, camera, spp, beside=False).items():
        for call in calls.values():
            call()
        for who, spent in alternate(calls, runs, PAUSE).items():
            print(f"{name}: {who} {_figure(name, spent, size * size * spp)}")


def _seen(points: int, size: int) -> tuple[pr.Model, pr.Camera]:
    model = pr.Model(pr.procedural("statue", points))
    return model, far_view(model.points, model.bounds, (size, size))


def _figure(name: str, seconds: float, samples: int) -> str:
    return f"{samples / seconds / 1e6:.2f} million samples a second" if name == "path" else f"{1e3 * seconds:.1f} ms"
