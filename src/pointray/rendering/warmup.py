"""Compile kernels before they are needed, in a second process: `python -m pointray.rendering.warmup NAME...`.

The kernel of pictures takes three times as long to compile as all kernels together that build a model, so both are
compiled at once; the kernels that a click in the viewer needs come after that. Kernels that send the rays of a bake
come before that of pictures that show its light, and after that of pictures that are shown until it is baked.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..baking.baked import bake
from ..baking.gather import send_rays
from ..baking.settings import BakeSettings
from ..jit import BACKLOG, KERNELS, compile_beside, is_compiled, name_of, wait_for
from ..kernels.records import BAKED, BAKED_FRAME
from ..scene.instances import Plane
from ..scene.scene import Scene
from ..scene.world import Snapshot
from ..shade.environment import EnvironmentLight
from ..shade.lights import SphereLight
from .camera import Camera
from .picture import KERNELS as INTEGRATOR_KERNELS
from .picture import kernel_for, render
from .settings import Settings

PACKAGE = (__package__ or "").split(".")[0]
# Seconds that kernels take on one core of 2024; a faster or slower machine is noticed, see `jit.Backlog`.
BUILD = {
    "neighbors.distinct._number": 0.3,
    "neighbors.order._cut": 0.7,
    "neighbors.rows._take": 0.2,
    "neighbors.sites._fill_blocks": 0.2,
    "neighbors.sites._fill_leaves": 0.2,
    "neighbors.sites._fill_levels": 0.1,
    "neighbors.search.find_nearest": 2.8,
    "points.strays.survey._survey": 2.6,
    "points.strays.survey._share": 0.4,
    "splats.closed._pack": 0.1,
    "splats.closed._measure_closed": 0.8,
    "splats.voronoi._measure": 1.4,
    "splats.borders._find_gaps": 0.5,
    "splats.medians._medians": 0.2,
    "splats.medians._medians_of": 0.3,
    "splats.sheets._find": 0.3,
    "tree.blocks._fill_blocks": 0.3,
    "tree.top._bound_groups": 0.4,
    "tree.cells.cut_roots": 3.2,
    "tree.leaves.fill_leaves": 3.7,
    "tree.leaves.fill_groups": 0.2,
    "tree.wide.enclose": 0.2,
    "tree.wide.collapse": 0.4,
}
NORMALS = {
    "points.normals.jets._fit": 1.4,
    "points.normals.pieces._join_tiles": 0.7,
    "points.normals.votes._count_votes": 0.1,
    "points.normals.votes._cast_votes": 0.3,
    "points.normals.joins._choose": 0.3,
    "points.normals.joins._join": 0.2,
    "points.normals.joins._number": 0.1,
    "points.normals.outward._choose": 0.1,
    "points.normals.winding._spacings": 0.2,
    "points.normals.winding._grow": 0.5,
    "points.normals.winding._join_roots": 0.2,
    "points.normals.winding._wind": 0.5,
}
CLICK = "trace.cast._closest"
SHARED = 20.0  # what all kernels that trace rays share: the first one in a process compiles it for all
PICTURES = {  # besides what is shared, as those that follow
    "rendering.integrate.quick_frame": 11.0,
    "rendering.integrate.sampled_frame": 8.0,
    CLICK: 5.0,
}
USUAL = 10.0  # of another integrator
RAYS = {CLICK: 5.0, "baking.gather.send_rays": 11.0}  # of a bake
BAKE = {
    "baking.reflectance.find_reflectances": 2.6,
    "baking.sky._average": 1.3,
    "baking.bounces.reflect": 0.2,
    "baking.bounces.add_irradiance": 0.4,
    "baking.bounces.add_facts": 0.6,
    "baking.bounces.hide_links": 0.7,
    "baking.smooth.smooth": 0.5,
    "baking.pack.pack": 0.6,
}
BLEND = {"baking.patches._blend": 0.7}  # of a bake too, where there are models


def warm_up(
    settings: Settings | None, clicks: bool = False, bakes: bool = False, before: Settings | None = None
) -> None:
    """Begin to compile what pictures of a scan need, if not yet compiled.

    settings : None: no pictures are wanted
    clicks, bakes : whether what clicks need, and what baking light needs, is wanted too
    before : of pictures that are shown until light is baked
    """
    wanted = _of_pictures(before)
    wanted |= {_full(name): cost for name, cost in (RAYS | BAKE).items()} if bakes else {}
    wanted |= _of_pictures(settings)
    if clicks:
        wanted.setdefault(_full(CLICK), PICTURES[CLICK])
    missing = [name for name in wanted if not is_compiled(KERNELS[name])]
    wanted.update({name: wanted[name] + SHARED for name in missing[:1]})
    compile_beside(__name__, wanted)
    expect(BUILD | BLEND if bakes else BUILD)


def _of_pictures(settings: Settings | None) -> dict[str, float]:
    """The kernel of pictures, and its cost."""
    if settings is None:
        return {}
    name = name_of(kernel_for(settings))
    return {name: PICTURES.get(name.removeprefix(f"{PACKAGE}."), USUAL)}


def expect(kernels: dict[str, float]) -> None:
    """Announce that this process compiles kernels soon, with the seconds that each takes."""
    BACKLOG.expect({_full(k): cost for k, cost in kernels.items() if not is_compiled(KERNELS[_full(k)])})


def is_warm(settings: Settings) -> bool:
    """Whether pictures can be drawn at once."""
    return is_compiled(kernel_for(settings))


def wait_until_warm(settings: Settings | None) -> None:
    """Wait until another process has compiled the kernel of pictures; None: that of the rays of a bake."""
    wait_for(send_rays if settings is None else kernel_for(settings), lambda: False)


class _NoLight:
    """Baked light that is black everywhere: pictures compile their kernel with it, and nothing is baked."""

    def tables(self, scene: Snapshot, levels: Any) -> tuple[Any, Any]:
        return np.zeros(BAKED * len(levels), np.int64), np.zeros(BAKED_FRAME * len(levels))

    def portable(self) -> _NoLight:
        return self


def _full(name: str) -> str:
    return f"{PACKAGE}.{name}"


def _compile(names: Sequence[str]) -> None:
    """Compile kernels by using them; print the name of each when it is done."""
    scene = Scene()
    scene.add(Plane((0, 0, 0), (0, 0, 1)))  # signatures are the same for any scene
    scene.add_light(EnvironmentLight())
    scene.add_light(SphereLight((0, 0, 2), 0.1, 1.0))  # a lamp, which hides links
    scene.baked = _NoLight()
    camera = Camera.look_at((1, 1, 1), (0, 0, 0), size=(8, 8))
    integrators = {name_of(kernel): integrator for integrator, kernel in INTEGRATOR_KERNELS.items()}
    for name in names:
        if name == _full(CLICK):
            scene.intersect((0, 0, 1), (0, 0, -1))
        elif name in map(_full, RAYS | BAKE):
            bake(scene, BakeSettings(links=1, patches=64, threads=1))
        else:
            render(scene, camera, Settings(integrators[name], threads=1))
        print(name, flush=True)


def _end_with_input() -> None:
    """End when the process that started this one ends, for any reason."""

    def watch() -> None:
        sys.stdin.buffer.read()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


if __name__ == "__main__":
    _end_with_input()
    try:
        _compile(sys.argv[1:])
    finally:
        os._exit(0)  # the thread that reads the input would be in the way
