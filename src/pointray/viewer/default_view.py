"""What `view` shows of anything but a scene: as `pointray view` shows files, a coarse version first."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..auto_view import STUDIO
from ..auto_view.default_scene import KINDS, is_list_of_clouds
from ..auto_view.first_view import ViewChoice
from ..auto_view.studio import with_direct_light
from ..base.arguments import Vector
from ..base.choices import MUTED
from ..io.exchange.convert import as_points, is_path
from ..io.remote.remote_file import Location
from ..model.model import Model
from ..model.model_cache import entry_of
from ..model.scan_inputs import check_scan, files_of, is_in_parts, is_saved
from ..rendering.settings import Settings
from ..rendering.warmup import warm_up
from ..scenefile import Plan
from .loading import FileLoader, SceneFileLoader
from .scene_setup import SceneSetup
from .shared_scene import Loader, SharedScene

SCENE_FILE = ".toml"


def default_view(x: Any, up: Vector | None) -> tuple[SharedScene, Loader]:
    """Return a shared scene, still empty, and the loader that fills it; check files and convert objects at once.

    x : paths, points, models, objects of other libraries, or a list of these; up : (3,), None: chosen automatically
    """
    things = list(x) if is_list_of_clouds(x, "scene") else [x]
    paths = [one for one in things if is_path(one)]
    if len(things) == 1 and paths and Path(paths[0]).suffix.lower() == SCENE_FILE:
        return _of_scene_file(Path(paths[0]))
    files = files_of(paths) if paths else []
    for file in files:
        check_scan(file)
    clouds = [one if isinstance(one, Model) else as_points(one, "scene", KINDS) for one in things if not is_path(one)]
    in_parts = any(map(is_in_parts, files)) or any(isinstance(cloud, Model) and cloud.parts for cloud in clouds)
    baked = Settings("baked", backfaces=MUTED)
    settings = with_direct_light(baked) if in_parts else baked
    setup = SceneSetup(settings, ViewChoice(up), bakes=not in_parts)
    if not in_parts:
        warm_up(settings, clicks=True, bakes=True, before=with_direct_light(settings))
    scans = [file for file in files if not is_saved(file)]
    entry = entry_of(scans, {"by": "view"}) if scans else None
    shared = SharedScene(_title(files, clouds), None, up or (0.0, 0.0, 1.0), settings)
    setup.shared, shared.exposes, shared.look = shared, True, STUDIO
    return shared, FileLoader(files, {}, setup, choice=setup.choice, entry=entry, clouds=clouds)


def _of_scene_file(file: Path) -> tuple[SharedScene, Loader]:
    plan = Plan(file)
    up = plan.camera.get("up", (0.0, 0.0, 1.0))
    return SharedScene(file.name, None, tuple(up), plan.settings, str(file)), SceneFileLoader(plan)


def _title(files: list[Location], clouds: list[Any]) -> str:
    if len(files) == 1 and not clouds:
        return files[0].name
    points = sum(len(cloud.points if isinstance(cloud, Model) else cloud) for cloud in clouds)
    return f"{len(files):,} files" if not clouds else f"{points:,} points"
