"""Compilation of kernels in a second process: `python -m pointray.rendering.warmup NAME...`.

The rendering kernel takes three times as long to compile as all kernels that build a model, so both are compiled in
parallel. The order is: the kernel of images shown until light is baked, the kernels of the bake, the kernel of images
with baked light, the kernel for clicks in the viewer.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..baking.baked import bake
from ..baking.gather import send_rays
from ..baking.settings import BakeSettings
from ..engine.jit import BACKLOG, KERNELS, compile_in_background, wait_for
from ..engine.kernels.records import BAKED, BAKED_FRAME
from ..scene.instances import Plane
from ..scene.scene import Scene
from ..scene.world import Snapshot
from ..shade.environment import EnvironmentLight
from ..shade.lights import SphereLight
from .camera import Camera
from .picture import KERNELS as INTEGRATOR_KERNELS, kernel_for, render
from .settings import Settings

PACKAGE = (__package__ or "").split(".")[0]
# Kernels compiled on a first start, with seconds; written by `bench/maintenance/record_kernels.py`. `jit.Backlog`
# corrects for the speed of the machine.
RECORD: dict[str, Any] = json.loads(Path(__file__).with_name("first_start.json").read_text())
BUILD, NORMALS = RECORD["build"], RECORD["normals"]  # kernels of a model; additional ones without normals
BAKE, BLEND = RECORD["bake"], RECORD["blend"]  # kernels of a bake; additional ones with models
PICTURES = RECORD["pictures"]  # without the shared time, as RECORD["rays"]
CLICK, RAYS = "surface.trace.cast._closest", "baking.gather.send_rays"
SHARED: float = RECORD["shared"]  # additional seconds of the first kernel of a process that traces rays


def warm_up(
    settings: Settings | None, clicks: bool = False, bakes: bool = False, before: Settings | None = None
) -> None:
    """Start compiling the kernels that images of a scan will need, unless they are compiled, in a second process.

    settings : of the images; None: no images
    clicks, bakes : also compile the kernels for clicks in the viewer (`Scene.intersect`), and for baking
    before : settings of images shown until light is baked; None: there are no such images
    """
    wanted = _of_pictures(before)
    wanted |= {_full(name): cost for name, cost in (RECORD["rays"] | BAKE).items()} if bakes else {}
    wanted |= _of_pictures(settings)
    if clicks:
        wanted.setdefault(_full(CLICK), RECORD["rays"][CLICK])
    missing = [name for name in wanted if not KERNELS[name].is_compiled]
    wanted.update({name: wanted[name] + SHARED for name in missing[:1]})
    compile_in_background(__name__, wanted)
    expect(BUILD | BLEND if bakes else BUILD)


def _of_pictures(settings: Settings | None) -> dict[str, float]:
    """Return the name of the rendering kernel for the settings, with its compile time in seconds; empty for None."""
    if settings is None:
        return {}
    name = kernel_for(settings).name
    return {name: PICTURES.get(name.removeprefix(f"{PACKAGE}."), max(PICTURES.values()))}


def expect(kernels: dict[str, float]) -> None:
    """Announce kernels that this process will compile, for estimates of the remaining time.

    kernels : expected compile time of each in seconds, by name without the package; compiled ones are left out
    """
    BACKLOG.expect({_full(k): cost for k, cost in kernels.items() if not KERNELS[_full(k)].is_compiled})


def is_warm(settings: Settings) -> bool:
    """Return whether the rendering kernel for the settings is compiled, in this process or on disk."""
    return kernel_for(settings).is_compiled


def has_clicks() -> bool:
    """Return whether the kernel of `Scene.intersect`, which serves clicks in the viewer, is compiled."""
    return bool(KERNELS[_full(CLICK)].is_compiled)


def wait_until_warm(settings: Settings | None) -> None:
    """Wait until the second process has compiled the rendering kernel for the settings, if it is compiling it.

    settings : None: wait for the kernel of the rays of a bake
    """
    wait_for(send_rays if settings is None else kernel_for(settings), lambda: False)


class _NoLight:
    """Baked light of zero irradiance, with which the rendering kernel is compiled without a bake."""

    def tables(self, scene: Snapshot, levels: Any) -> tuple[Any, Any]:
        return np.zeros(BAKED * len(levels), np.int64), np.zeros(BAKED_FRAME * len(levels))

    def portable(self) -> _NoLight:
        return self


def _full(name: str) -> str:
    return f"{PACKAGE}.{name}"


def _compile(names: Sequence[str]) -> None:
    """Compile kernels by calling them with a small scene; print the name of each when it is compiled.

    names : of kernels in `KERNELS`
    """
    scene = Scene()
    scene.add(Plane((0, 0, 0), (0, 0, 1)))  # signatures do not depend on the scene
    scene.add_light(EnvironmentLight())
    scene.add_light(SphereLight((0, 0, 2), 0.1, 1.0))  # a lamp, which hides links
    scene.baked = _NoLight()
    camera = Camera.look_at((1, 1, 1), (0, 0, 0), size=(8, 8))
    integrators = {kernel.name: integrator for integrator, kernel in INTEGRATOR_KERNELS.items()}
    for name in names:
        if name == _full(CLICK):
            scene.intersect((0, 0, 1), (0, 0, -1))
        elif name in map(_full, [RAYS, *BAKE]):
            bake(scene, BakeSettings(links=1, patches=64, threads=1))
        else:
            render(scene, camera, Settings(integrators[name], threads=1))
        print(name, flush=True)


def _end_with_input() -> None:
    """Start a thread that ends this process when its input ends: the parent process has ended, for any reason."""

    def watch() -> None:
        sys.stdin.buffer.read()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


if __name__ == "__main__":
    _end_with_input()
    try:
        _compile(sys.argv[1:])
    finally:
        os._exit(0)  # the thread that reads the input would block a normal exit
