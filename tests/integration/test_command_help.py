"""Declared options, `--help` of each command, and suggestions for misspelt names."""

import inspect
from dataclasses import fields

import pytest
from typer.main import get_command
from typer.models import OptionInfo
from typer.testing import CliRunner

import pointray as pr
from helpers.clouds import sphere_points
from pointray.base.manual import MANUAL
from pointray.cli import commands, execute
from pointray.cli.commands import app
from pointray.cli.declare import PANELS, declarations
from pointray.cli.picture_options import IN_BAKE, IN_CAMERA, IN_ROOT, IN_SETTINGS, PictureOptions, names_of
from pointray.cli.read_options import Reading
from pointray.scenefile import light, plan
from pointray.scenefile.words import words_of

NAMES = [command.name or command.callback.__name__ for command in app.registered_commands]
WIDTH = 100


def help_of(*words):
    """Return the lines of a help text on a terminal of 100 columns."""
    result = CliRunner().invoke(app, [*words, "--help"], env={"COLUMNS": str(WIDTH), "TERMINAL_WIDTH": str(WIDTH)})
    assert result.exit_code == 0
    return [line.rstrip() for line in result.output.splitlines()]


@pytest.mark.parametrize("group", [PictureOptions, Reading])
def test_each_option_has_a_panel_and_help(group):
    for name, declared in declarations(group).items():
        assert declared.info.rich_help_panel in PANELS, name
        assert declared.info.help and declared.info.help.endswith("."), name
        assert set(declared.commands) <= set(NAMES), name


@pytest.mark.parametrize("words", [(), *((name,) for name in NAMES)])
def test_help_names_the_manual_and_no_file_of_the_repository(words):
    lines = help_of(*words)
    assert f" Manual: {MANUAL}" in lines and "docs/" not in "".join(lines)


def test_each_option_of_pictures_is_declared_once():
    """No command has its own parameter for an option that the dataclass declares."""
    declared = declarations(PictureOptions)
    for name in NAMES:
        command = getattr(commands, name)
        own = set(inspect.signature(command.__wrapped__).parameters)
        assert not [each for each in own & set(declared) if name in declared[each].commands], name
        options = inspect.signature(command).parameters
        for each in options.values():
            info = getattr(each.annotation, "__metadata__", [None])[0]
            assert not isinstance(info, OptionInfo) or info.rich_help_panel in PANELS, f"{name} {each.name}"
            if each.name in declared and name in declared[each.name].commands:
                assert info is declared[each.name].info


def test_scene_files_have_the_keys_that_options_replace():
    words = {IN_CAMERA: plan.LOOK_AT, IN_SETTINGS: words_of(pr.Settings), IN_ROOT: plan.ROOT}
    for table, known in words.items():
        assert set(names_of(table)) <= set(known)
    assert names_of(IN_BAKE) == ("bake",) and "file" in light.WORDS


def test_defaults_equal_those_of_python():
    """Exceptions are the number of samples and automatic choices."""
    options = {each.name: each.default for each in fields(PictureOptions)}
    automatic = {"spp", "integrator", "backfaces"}
    for name in set(names_of(IN_SETTINGS)) - automatic:
        assert options[name] == getattr(pr.Settings(), name), name
    for name in ("fov", "projection", "aperture", "focus"):
        assert options[name] == inspect.signature(pr.Camera.look_at).parameters[name].default, name
    for name in ("surface", "samples", "radius_scale", "smooth", "scatter", "scatter_size"):
        assert options[name] in (inspect.signature(pr.Model).parameters[name].default, "auto", 1.0), name


@pytest.mark.parametrize("name", [None, *NAMES])
def test_help_fits_and_starts_with_two_examples(name):
    lines = help_of(*([name] if name else []))
    assert max(map(len, lines)) <= WIDTH
    first = lines.index(" Examples:")
    assert first <= 5 and all(not line or "Usage:" in line for line in lines[:first])
    assert all(line.startswith(f"   pointray {name or ''}") for line in lines[first + 1 : first + 3])
    assert not lines[first + 3]


@pytest.mark.parametrize("name", NAMES)
def test_the_examples_of_help_parse(name):
    """Only the files are missing."""
    lines = help_of(name)
    first = lines.index(" Examples:")
    for line in lines[first + 1 : first + 3]:
        words = line.split()[1:]
        get_command(app).commands[name].make_context(name, words[1:])


def test_render_has_its_panels_in_order():
    titles = [line.split("─")[1].strip() for line in help_of("render") if line.startswith("╭")]
    assert titles == ["Arguments", "Input", "Camera", "Light", "Look", "Quality", "Output", "Cluster"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a scan that has an attribute."""
    rows = sphere_points(300)
    pr.write(tmp_path / "scan.ply", pr.Points(rows, rows, attributes={"intensity": rows[:, 0]}))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("words", "end"),
    [
        ("rendr scan.ply", "Did you mean 'render'?"),
        ("render scan.ply -o a.png --elevaton 3", "No such option: --elevaton (did you mean '--elevation'?)"),
        ("render scn.ply -o a.png", "scn.ply: No such file or directory (did you mean 'scan.ply'?)"),
        ("info SCAN.PLY.ply", "(did you mean 'scan.ply'?)"),
        ("render scan.ply -o a.png --color-by intensty", "(did you mean 'intensity'?)"),
        ("render scan.ply -o a.png --color-by hieght", "(did you mean 'height'?)"),
        ("info scan.ply --keep intensit=1", "(did you mean 'intensity'?)"),
        ("render scene.toml -o a.png", "models.a.file: scn.ply: No such file or directory (did you mean 'scan.ply'?)"),
        ("render keys.toml -o a.png", "keys.toml:2: models.a.pointz: unknown key 'pointz' (did you mean 'points'?); "),
        ("render unlike.xyz -o a.png", "unlike.xyz: No such file or directory"),
        ("render scan.ply -o a.png --qqqqqqq", "No such option: --qqqqqqq"),
    ],
)
def test_the_closest_match_is_suggested(words, end, folder, capsys):
    instance = '[[instances]]\nmodel = "a"\n'
    (folder / "scene.toml").write_text(f'[models.a]\nfile = "scn.ply"\n{instance}')
    (folder / "keys.toml").write_text(f'[models.a]\npointz = 100\nprocedural = "sphere"\n{instance}')
    assert execute(words.split()) == 2
    err = capsys.readouterr().err.splitlines()[-1]
    assert end in err and (err.endswith(end) or "; " in end)
