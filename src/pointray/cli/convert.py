"""pointray convert: writes the points of a scan in another format, or as Gaussian splats."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from ..io.known_formats import writer_of
from ..io.remote.remote_file import Location
from ..model.scan_inputs import check_not_input, check_result
from .options import up_axis
from .read_options import Reading
from .scan_files import ScanFiles, read_scan, scan_of
from .waiting import Progress, in_background, writing

SPLATS = (".spz", ".splat")  # formats of Gaussian splats only


class SplatOptions(NamedTuple):
    """Options of the command for Gaussian splats.

    Attributes
    ----------
    splats : bool
        Whether a .ply holds Gaussian splats.
    light : list of str or None
        Lights that are baked into the colours; None: none.
    up : str
        Up direction of the studio's lights.
    """

    splats: bool = False
    light: list[str] | None = None
    up: str = "auto"

    def check(self, output: Path) -> bool:
        """Return whether the result holds Gaussian splats; raise ValueError if an option does not fit its extension."""
        extension = output.suffix.lower()
        if self.splats and extension not in (".ply", *SPLATS):
            raise ValueError(f"{output}: --splats requires .ply, {', '.join(SPLATS)}")
        found = self.splats or extension in SPLATS
        if self.light and not found:
            raise ValueError(f"{output}: --light requires {', '.join(SPLATS)}, or .ply with --splats")
        if self.up != "auto" and not self.light:
            raise ValueError("--up requires --light")
        return found


def convert(
    paths: Sequence[Location],
    reading: Reading,
    output: Path,
    force: bool,
    splats: SplatOptions,
    compressed: bool = False,
) -> str:
    """Read a scan and write it in the format of the output's extension; return the lines that the command prints.

    force : whether the output may overwrite an input; splats : options for Gaussian splats
    compressed : whether the compressed variant of PCD is written
    """
    check_result(output)
    if compressed:
        writer_of(output, compressed)
    as_splats = splats.check(output)
    scan = scan_of(paths, reading)
    check_not_input(scan.files, output, force)
    if as_splats and splats.light:
        return _convert_lit(scan, output, splats)
    scan.check()
    with Progress() as progress:
        progress.show("reading", 0.0)
        points, model = in_background(lambda: read_scan(scan, progress.show))
        write = partial(_write_splats, model=model) if as_splats else partial(_write, compressed=compressed)
        progress.show("writing", 0.0)
        with writing(output):
            count, lost = in_background(lambda: write(output, points, progress))
    return "; ".join([f"{output}: {count:,} points", *lost])


def _write(output: Path, points: Any, progress: Progress, compressed: bool) -> tuple[int, list[str]]:
    """Write points to a file; return how many were given, and messages about what its format cannot store."""
    from ..io.files import write_points

    return len(points), write_points(output, points, lambda share: progress.show("writing", share), compressed)


def _write_splats(output: Path, points: Any, progress: Progress, model: Any = None) -> tuple[int, list[str]]:
    """Write points or their model as Gaussian splats; return their number, and what the format cannot store."""
    from ..auto_view.splats import write_subject

    return write_subject(output, points if model is None else model, None, progress.show)


def _convert_lit(scan: ScanFiles, output: Path, options: SplatOptions) -> str:
    """Write a scan as Gaussian splats with baked light; return the lines that the command prints."""
    from ..auto_view.first_view import ViewChoice
    from ..auto_view.splats import lit_colors, write_model
    from ..baking.settings import BakeSettings
    from .bake import check_bakeable
    from .baked_light import LightSource
    from .picture_options import PictureOptions
    from .scan_scene import ScanScene

    check_bakeable(options.light)
    source, up = LightSource(BakeSettings()), up_axis(options.up)
    pictured = PictureOptions(light=options.light, up=up)
    scan_scene = ScanScene(scan, pictured, ViewChoice(up, azimuth=0.0), baked=source)
    with Progress(bakes=True) as progress:
        scene, model, found = scan_scene.build(progress)
        model.check_whole()
        baked = in_background(lambda: source.make(scene, progress.show))
        lit = in_background(lambda: lit_colors(scene, baked, next(iter(scene.shapes)), found.up))
        with writing(output):
            count, lost = in_background(lambda: write_model(output, model, lit.colors, progress.show))
    soft = ", highlights softened" if lit.curve == "soft" else ""
    what = f"{output}: {count:,} points, lit colours, exposure {lit.exposure:g}{soft}"
    return "\n".join(filter(None, ["; ".join([what, *lost]), found.found]))
