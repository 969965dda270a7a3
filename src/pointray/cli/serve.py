"""pointray view: opens a page in the browser at once and shows files there while they load."""

from __future__ import annotations

import logging
import signal
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..base.choices import AUTO
from ..model.scan_inputs import check_scan, files_of, is_in_parts, is_saved
from .baked_light import FIRST, light_source
from .options import background_of
from .read_options import Reading
from .scan_files import ScanFiles, check_unread
from .scan_lights import ScanLights
from .scan_scene import ground_under
from .scan_surface import PLAIN, check_saved
from .scene_file import DescribedScene, scene_of

SERVING = ("host", "port", "open_browser")  # options of the server, not of the scene


def shared_scene_of(
    paths: Sequence[Path],
    reading: Reading,
    typed: dict[str, Any],
    options: dict[str, Any],
    surface: dict[str, Any],
    cached: bool = False,
) -> Any:
    """Return the scene that browsers show, an empty `SharedScene`, and the loader that fills it while it is shown.

    Files and options are checked at once; an error is raised if one is invalid.

    typed : options that the user typed, parsed, by name
    options : fields of `PictureOptions` by name; also "settings", "quick" (whether light is baked without a request)
        and perhaps "memory", bytes for open parts of models
    surface : keyword arguments of `Model`; only the default surface gets levels of detail
    cached : whether the model of scans may come from the cache on disk, and is stored there
    """
    from ..auto_view.first_view import ViewChoice
    from ..auto_view.studio import with_direct_light
    from ..rendering.warmup import warm_up
    from ..viewer.loading import FileLoader, SceneFileLoader
    from ..viewer.scene_setup import SceneSetup
    from ..viewer.shared_scene import SharedScene

    scene_file = scene_of(paths)
    if scene_file is not None:
        described = DescribedScene(scene_file, typed, SERVING)
        plan = described.plan
        if described.bakes:  # before the first image
            _print(FIRST)
            warm_up(plan.settings, clicks=True, bakes=True)
        up = plan.camera.get("up", (0.0, 0.0, 1.0))
        return SharedScene(scene_file.name, None, tuple(up), plan.settings, str(scene_file)), SceneFileLoader(plan)
    choice = ViewChoice(options["up"])
    lights = ScanLights(options["light"], options["fill"])
    background = background_of(options["background"])
    files = files_of(paths)
    check_unread(files, reading)
    for file in files:
        check_scan(file, reading.request)
        check_saved(file, options["normals"] == AUTO)
    title, source = files[0].name, str(files[0]) if reading.is_plain else ""
    if len(files) > 1:
        title, source = f"{len(files):,} files", ""
    settings, in_parts = options["settings"], any(map(is_in_parts, files))
    if in_parts and options["quick"]:
        settings = with_direct_light(settings)
    if options.get("memory") is not None and not in_parts:
        raise ValueError("--memory requires a model in parts")
    baked = light_source(settings, options["bake"])
    from_file = baked is not None and baked.file is not None
    if baked is not None and not from_file:
        warm_up(settings, clicks=True, bakes=True, before=with_direct_light(settings))
    setup = SceneSetup(settings, choice, lights.make, baked is not None, options["quick"], options["backfaces"] is None)
    setup.ground = ground_under if options["ground"] else None
    setup.background, setup.report = background, _print
    leveled = settings.levels and surface == PLAIN and not from_file  # light of a file fits the full model only
    light = baked.make if baked is not None and from_file else None
    scans = ScanFiles(tuple(file for file in files if not is_saved(file)), reading, cached)
    entry = scans.entry(normals=options["normals"], **surface) if scans.files else None
    kept = reading.arguments, entry, reading.drop_strays, options.get("memory")
    loader = FileLoader(files, surface, setup, leveled, options["normals"], choice, light, *kept)
    shared = SharedScene(title, None, choice.up or (0.0, 0.0, 1.0), settings, source)
    setup.shared, shared.exposes, shared.look = shared, True, lights.look or ""
    shared.contact_shadow = options["contact_shadow"]
    return shared, loader


def serve(shared: Any, loader: Any, host: str, port: int, open_browser: bool) -> None:
    """Show a scene in browsers until Ctrl-C, which raises KeyboardInterrupt.

    shared, loader : as returned by `shared_scene_of`; host, port : address to listen on; port 0: 8080 or higher
    """
    from ..base.malloc_arenas import keep_one_heap

    keep_one_heap()
    log, handler = logging.getLogger("pointray.view"), logging.StreamHandler()
    log.addHandler(handler)
    try:
        _serve(shared, loader, host, port, open_browser)
    finally:
        log.removeHandler(handler)


def _serve(shared: Any, loader: Any, host: str, port: int, open_browser: bool) -> None:
    from ..viewer.viewer import Viewer

    viewer = Viewer(shared, host, port)
    if port not in (0, viewer.port):
        _print(f"port {port} is in use")
    if viewer.is_public:
        _print(f"note: --host {host}: everyone who can reach this computer and knows the address can see the model")
    shared.load(loader)
    opened = open_browser and viewer.open_browser()
    _print(f"{viewer.url}{'' if opened else ' (open it in a browser)'}, press Ctrl-C to stop")
    interrupted: list[int] = []
    if threading.current_thread() is threading.main_thread():
        # The handler raises nothing: an exception raised while an object is being freed is lost.
        signal.signal(signal.SIGINT, lambda number, frame: interrupted.append(number))
    viewer.wait(lambda: bool(interrupted))
    if interrupted:
        raise KeyboardInterrupt


def _print(text: str) -> None:
    print(f"pointray: {text}", file=sys.stderr, flush=True)
