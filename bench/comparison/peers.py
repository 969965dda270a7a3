"""The programs that are compared: how each is run, with which settings, and where these come from."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import pointray as pr
from bench.looks.cloudcompare import seen_from
from bench.looks.scatter_sheets import options_of

SCRIPTS = Path(__file__).with_name("scripts")
LLVM = "DRJIT_LIBLLVM_PATH"
OPEN3D = "https://www.open3d.org/docs/latest"


@dataclass(frozen=True)
class Peer:
    """A program and one of its ways to draw a scan.

    key : name of its script and its pictures
    needs : modules and programs; install : command that installs them
    settings : what was chosen; source : where it is documented
    """

    key: str
    name: str
    package: str
    needs: tuple[str, ...]
    install: str
    settings: str
    source: str

    @property
    def missing(self) -> list[str]:
        """What is not installed."""
        found = (importlib.util.find_spec(name) is not None or shutil.which(name) is not None for name in self.needs)
        return [name for name, here in zip(self.needs, found, strict=True) if not here]

    @property
    def version(self) -> str:
        try:
            return importlib.metadata.version(self.package)
        except importlib.metadata.PackageNotFoundError:
            query = ["dpkg-query", "--show", "--showformat=${Version}", self.package]
            return subprocess.run(query, capture_output=True, text=True).stdout or "unknown"

    @property
    def lines(self) -> str:
        """Lines of the script, or commands, without blank lines, comments and the docstring."""
        if self.key == "pointray":
            return "1 command"
        if self.key == "cloudcompare":
            return "2 commands, then the mouse"
        body = (SCRIPTS / f"{self.key}.py").read_text().split('"""', 2)[2]
        return str(sum(bool(line.strip()) and not line.strip().startswith("#") for line in body.splitlines()))

    def command(self, scan: Path, camera: pr.Camera, view: Path, picture: Path) -> list[str]:
        """The command that is measured. view : the camera as JSON, in a folder for files of this scan"""
        if self.key == "pointray":
            options = ["--no-cache", "--background", "1,1,1", *options_of(camera)]
            return [sys.executable, "-m", "pointray", "render", str(scan), "-o", str(picture), *options]
        if self.key == "cloudcompare":
            seen = view.with_name("seen.ply")
            if not seen.exists():
                pr.write(seen, seen_from(pr.read(scan), camera))
            size = "{}x{}".format(*camera.size)
            return [sys.executable, "-m", "bench.looks.cloudcompare", str(seen), size, str(picture)]
        return [sys.executable, str(SCRIPTS / f"{self.key}.py"), str(scan), str(view), str(picture)]


_OPEN3D = Peer(
    "open3d_points",
    "Open3D, points",
    "open3d",
    ("open3d",),
    "pip install open3d, apt-get install libvulkan1 mesa-vulkan-drivers",
    "`OffscreenRenderer` on the CPU; points of 3 pixels, lit by the default light with their normals",
    f"[software rendering]({OPEN3D}/tutorial/visualization/cpu_rendering.html), Open3D's example render_to_image",
)
_PYVISTA = Peer(
    "pyvista_points",
    "PyVista, points",
    "pyvista",
    ("pyvista",),
    "pip install pyvista",
    "points of 5 pixels, the default, lit with their normals",
    "[example of a lidar scan](https://docs.pyvista.org/examples/02-plot/edl)",
)
PEERS = [
    Peer(
        "pointray",
        "pointray",
        "pointray",
        (),
        "",
        "`pointray render` with its defaults: a studio with baked global illumination",
        "[tutorial](tutorial.md)",
    ),
    _OPEN3D,
    replace(
        _OPEN3D,
        key="open3d_poisson",
        name="Open3D, Poisson mesh",
        settings="depth 9; the 1% of the vertices with the lowest density are removed; the same light. A new process"
        " draws the mesh, as the renderer often hangs (with Mesa 22.3.6) in the one that made it",
        source=f"[surface reconstruction]({OPEN3D}/tutorial/geometry/surface_reconstruction.html)",
    ),
    _PYVISTA,
    replace(
        _PYVISTA,
        key="pyvista_edl",
        name="PyVista, eye-dome lighting",
        settings="the same points with `enable_eye_dome_lighting`",
    ),
    Peer(
        "mitsuba_ellipsoids",
        "Mitsuba 3, ellipsoids",
        "mitsuba",
        ("mitsuba", "plyfile", "scipy"),
        "pip install mitsuba plyfile scipy, apt-get install libllvm19",
        "path traced with 16 samples a pixel, a sun and a sky; flat ellipsoids along the normals, as wide as the"
        " distance to the 3 nearest points, as in Gaussian splatting; colours by a texture in Python, as none of"
        " Mitsuba's reads attributes of ellipsoids",
        "[`ellipsoids`](https://mitsuba.readthedocs.io/en/stable/src/generated/plugins_shapes.html),"
        " [custom plugins](https://mitsuba.readthedocs.io/en/stable/src/others/custom_plugins.html)",
    ),
    Peer(
        "cloudcompare",
        "CloudCompare",
        "cloudcompare",
        ("CloudCompare", "Xvfb", "xdotool"),
        "apt-get install --no-install-recommends cloudcompare xvfb xdotool",
        "points of 3 pixels; the window is captured on a virtual screen, because the command line mode draws nothing."
        " The camera cannot be set from outside, so it shows points that were projected to this camera before, which is"
        " not timed. Timed are the conversion to its own format and opening that until the window shows the points",
        "[issue 1431](https://github.com/CloudCompare/CloudCompare/issues/1431),"
        " [command line mode](https://www.cloudcompare.org/doc/wiki/index.php?title=Command_line_mode)",
    ),
    Peer(
        "f3d_sprites",
        "F3D, point sprites",
        "f3d",
        ("f3d",),
        "pip install f3d==3.5.0 (4.0.0 does not show the colours)",
        "circles of size 2 in the points' colours, anti-aliasing. Its command line program, which is not in the package"
        " of PyPI, does the same in one command",
        "[options](https://f3d.app/docs/user/OPTIONS)",
    ),
]


def environment() -> dict[str, str]:
    """The environment of all programs; Mitsuba takes the newest LLVM of Debian, as old ones lack new processors."""
    found = sorted(Path("/usr/lib/x86_64-linux-gnu").glob("libLLVM.so.*"))  # LLVM 18 and later
    return {LLVM: str(found[-1]), **os.environ} if found else dict(os.environ)
