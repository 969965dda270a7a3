"""Options shared by the command line and the viewer's panel, and their copies as commands."""

import shlex
from dataclasses import replace

import numpy as np
import pytest

import pointray as pr
from pointray.auto_view.studio import studio
from pointray.base.choices import AUTO
from pointray.cli import execute, serve
from pointray.cli.read_options import Reading
from pointray.cli.scan_surface import PLAIN
from pointray.viewer.exports import _command, _python
from pointray.viewer.painter import FrameRequest
from pointray.viewer.panel import Output, folders
from pointray.viewer.shared_scene import SharedScene
from pointray.viewer.view_settings import ViewSettings

UP = (0.0, 0.0, 1.0)


@pytest.fixture(scope="module")
def bowl(tmp_path_factory):
    """A file of a shallow bowl whose back faces are visible."""
    points = pr.procedural("sphere", 3_000)
    path = tmp_path_factory.mktemp("bowl") / "bowl.ply"
    pr.write(path, points.select(points.positions[:, 2] < -0.5))
    return path


def viewed(file, backfaces=None, contact_shadow=True):
    """The shared scene of `pointray view` of a file, and the first view settings of a browser."""
    options = {"up": UP, "light": None, "fill": None, "background": AUTO, "ground": False, "normals": AUTO}
    options |= {"settings": pr.Settings("phong", backfaces=backfaces or "muted"), "bake": None, "quick": False}
    options |= {"backfaces": backfaces, "contact_shadow": contact_shadow}
    shared, loader = serve.shared_scene_of([file], Reading(), {}, options, dict(PLAIN))
    shared.load(loader).join(120)
    assert shared.problem == ""
    return shared, ViewSettings.of(shared, shared.scene)


def rows_of(view, shared):
    """The rows of the panel by name."""
    return {row.name: row for part in folders(view, shared, Output(), shared.scene) for row in part.controls}


def test_the_panel_shows_options_of_the_command_line(bowl):
    shared, view = viewed(bowl, "muted", False)
    rows = rows_of(view, shared)
    assert rows["backfaces"].value == "muted" and rows["contact_shadow"].value is False
    assert [value for value, _ in rows["backfaces"].options] == ["muted", "same"]
    assert view.settings(1).backfaces == "muted"
    changed = view.with_value("backfaces", "same").with_value("contact_shadow", True)
    assert changed.settings(1).backfaces == "same" and changed.same_scene(view)
    assert rows_of(changed, shared)["contact_shadow"].value is True


def test_the_viewer_chooses_back_faces_by_default(bowl):
    """The first view of a bowl is from above."""
    shared, view = viewed(bowl)
    assert view.backfaces == "same" and view.contact_shadow
    assert rows_of(view, shared)["backfaces"].value == "same"


def test_rows_without_effect_are_left_out(bowl):
    shared, view = viewed(bowl)
    assert "backfaces" not in rows_of(replace(view, integrator="path"), shared)
    assert "contact_shadow" in rows_of(replace(view, integrator="path"), shared)
    for other in (replace(view, integrator="normal"), view.lit_by([], UP, "phong")):
        assert "contact_shadow" not in rows_of(other, shared)
    scene = pr.Scene()
    scene.add(pr.Model(pr.procedural("sphere", 500)))
    given = SharedScene("a", scene)  # of Python or a scene file, for which no contact shadow is computed
    lit = ViewSettings.of(given, scene).in_studio(studio(UP), UP)
    assert lit.look == "studio" and "contact_shadow" not in rows_of(lit, given)


@pytest.mark.parametrize(
    ("changes", "expected", "settings"),
    [
        ({"backfaces": "muted"}, "--backfaces muted", {"backfaces": "muted"}),
        ({"backfaces": "same"}, "--backfaces same", {}),
        ({"contact_shadow": False}, "--no-contact-shadow", {}),
    ],
)
def test_settings_of_the_panel_are_copied(changes, expected, settings):
    """The command parses, and Python code sets the same."""
    view = replace(ViewSettings().in_studio(studio(UP, 25.0), UP), **changes)
    request = FrameRequest(pr.Camera.look_at((0, -4, 0), (0, 0, 0)), view, pr.Scene(), (1, 0), UP, True, 0.0)
    command = _command(request, Output(), "scan.ply")
    assert f" {expected} " in command and command.count("--backfaces") == 1
    names = {"pr": pr}
    exec(_python(request, Output()).split("image =")[0], names)
    assert names["settings"] == pr.Settings(view.integrator, spp=16, **settings)
    assert "--contact-shadow" not in command
    assert "--backfaces" not in _command(request._replace(view=replace(view, integrator="path")), Output(), "a.ply")
    of_scene = _command(request._replace(view=replace(view, base=view.settings(1))), Output(), "a.toml")
    assert "--backfaces" not in of_scene and "contact" not in of_scene


def test_the_surface_of_the_panel_is_copied(tmp_path):
    points = pr.Points(np.random.default_rng(2).random((40, 3)))
    scene = pr.Scene()
    scene.add(pr.Model(points, surface="imls", scatter="discs", scatter_size=1.5, smooth=0.25))
    shared = SharedScene("a", scene)
    request = FrameRequest(pr.frame(scene), ViewSettings(), scene, (1, 0), UP, True, 0.0)
    command = _command(request, Output(), "scan.ply", shared.build)
    for expected in ("--surface imls", "--scatter discs", "--scatter-size 1.5", "--smooth 0.25"):
        assert f" {expected} " in f"{command} "
    assert "--radius-scale" not in command and "--samples" not in command
    assert "--surface" not in _command(request, Output(), "scan.pointray", shared.build)
    pr.write(tmp_path / "scan.ply", points)
    words = shlex.split(command.replace("scan.ply", str(tmp_path / "scan.ply")).replace("picture", str(tmp_path / "p")))
    assert execute([*words[1:], "--size", "16x12", "--spp", "1"]) == 0
