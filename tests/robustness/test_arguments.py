"""Wrong values for every parameter of everything public must be refused at the call, by name, or make sense."""

from __future__ import annotations

import inspect
import re
import secrets
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pointray as pr
from pointray.engine.jit import compilations

# Results, which callers do not create.
RESULTS = {
    *("Baked", "Flaws", "FormatFacts", "Hits", "Layers", "NormalsCheck"),
    *("Prepared", "SceneFile", "StaleLightWarning", "Strays", "Viewer"),
}

WRONG: dict[str, Any] = {
    "None": None,
    "text": "a",
    "number as text": "1",
    "bytes": b"a",
    "object": object(),
    "list": [],
    "dict": {},
    "set": {1},
    "lambda": lambda *_: 1,
    "True": True,
    "True of NumPy": np.bool_(True),
    "array of True": np.ones(3, bool),
    "array of objects": np.array([object()] * 3),
    "array of texts": np.array(["a", "b", "c"]),
    "array of numbers as text": np.array(["1", "2", "3"]),
    "complex": 1j,
    "array of complex": np.ones(3, complex),
    "dates": np.zeros(3, "M8[s]"),
    "ragged": [[1, 2, 3], [4]],
    "list of None": [None, None, None],
    "array (2, 5, 7)": np.ones((2, 5, 7)),
    "array (0, 3)": np.ones((0, 3)),
    "pair": (1, 2),
    "half": 0.5,
    "nan": np.nan,
    "inf": np.inf,
    "-inf": -np.inf,
    "-1": -1,
    "2**70": 2**70,
    "10**400": 10**400,
    "list of 10**400": [10**400] * 3,
    "list of nan": [np.nan] * 3,
}
TEXTS = {"text", "number as text"}
BOOLS = {"True", "True of NumPy"}
ARRAYS = {"array (2, 5, 7)", "array (0, 3)", "pair", "list", "list of nan", "array of True"}
NUMBERS = {"half", "inf", "-inf", "-1", "2**70"}
# Values that each annotation accepts; all others must be refused.
SENSE: dict[str, set[str]] = {
    "bool": BOOLS,
    "int": {"-1", "2**70", "10**400"},
    "float": NUMBERS,
    "str": TEXTS,
    "None": {"None"},
    "ArrayLike": ARRAYS | NUMBERS | {"nan"},
    "Doubles": ARRAYS,
    "NDArray": ARRAYS | NUMBERS | {"nan"},
    "Any": ARRAYS | NUMBERS | {"nan"},  # a result of `Camera.rays_through`
    "Color": ARRAYS | NUMBERS | {"None"},
    "Vector": ARRAYS,
    "tuple": {"list", "pair"},
    "list": {"list", "pair"},
    "Sequence": {"list"},
    "Iterable": {"list", "dict", "array (0, 3)"},
    "Mapping": {"dict"},
    "Callable": {"lambda"},
    "StageProgress": {"lambda"},
    "os.PathLike": TEXTS,
    "PointsLike": set(),  # a path that does not exist, or wrong arrays
    **dict.fromkeys(
        ("Attribute", "BakeSettings", "BakedLight", "Camera", "EnvironmentLight", "Light", "Material", "Model"), set()
    ),
    "Client": {"None"},  # of Dask
    **dict.fromkeys(("Backdrop", "Plane", "Points", "Scene", "Settings", "Georeference", "Trajectory", "slice"), set()),
    "SharedScene": set(),
}
ARRAY_KINDS = {"ArrayLike", "Doubles", "NDArray", "Any", "Color", "Vector"}  # wrong dtypes are ValueErrors
PATHS = {"path", "paths", "out", "image", "host", "trajectory", "points", "x", "scene", "subject"}


class Things:
    """The arguments of valid calls."""

    def __init__(self, folder: Path) -> None:
        rows = np.random.default_rng(0).normal(size=(500, 3))
        rows /= np.linalg.norm(rows, axis=1, keepdims=True)
        self.points = pr.Points(rows, rows, attributes={"height": rows[:, 2]})
        self.rows = rows
        self.model = pr.Model(self.points)
        self.scene = pr.Scene()
        self.scene.add(self.model)
        self.lit = self.scene.copy()
        self.lit.add_light(pr.EnvironmentLight())
        self.camera = pr.Camera.look_at((0, -4, 1), (0, 0, 0), size=(8, 8))
        self.folder = folder
        self.timed = pr.Points(rows, attributes={"gps_time": np.arange(500.0)})
        self.trajectory = folder / "flight.txt"
        self.trajectory.write_text("0 0 0 5\n499 5 0 5\n")
        pr.write(folder / "a.ply", self.points)
        self.model.save(folder / "a.pointray")
        (folder / "a.toml").write_text("[camera]\neye = [0, -4, 0]\ntarget = [0, 0, 0]\n")

    def changed(self) -> pr.Scene:
        return self.scene.copy()

    def prepare(self, **given: Any) -> pr.Prepared:
        """Prepare into a new file, or a folder where a parameter requires a model in parts."""
        out, parts = self.folder / secrets.token_hex(8), {"in_parts", "part_points", "memory", "client"}
        in_parts = (parts | {"scatter", "scatter_size"}) & given.keys()
        told: dict[str, Any] = {"out": f"{out}.pointray/" if in_parts else f"{out}.ply"}
        if {"viewpoint", "trajectory"} & given.keys():
            told["normals"] = "fit"
        return pr.prepare(**{**told, **given})


Call = tuple[Callable[..., Any], dict[str, Any]]


def valid_calls(t: Things) -> dict[str, Call]:
    """A valid call of everything public that takes a value."""
    eye = {"eye": (0, -4, 1), "target": (0, 0, 0)}
    rays = {"origins": [0, -4, 0], "directions": [0, 1, 0]}
    scene, widget = t.changed(), pr.ViewerWidget(t.scene)
    return {
        "Attribute": (pr.Attribute, {"name": "height"}),
        "Camera": (pr.Camera, eye),
        "Camera.look_at": (pr.Camera.look_at, eye),
        "Camera.frame": (pr.Camera.frame, {"bounds": t.points.bounds}),
        "Camera.rays": (t.camera.rays, {"rows": slice(0, 2)}),
        "Camera.rays_through": (t.camera.rays_through, {"u": 0, "v": 0}),
        "Dielectric": (pr.Dielectric, {}),
        "Diffuse": (pr.Diffuse, {}),
        "DiskLight": (pr.DiskLight, {"center": (0, 0, 3), "normal": (0, 0, -1), "radius": 1, "radiance": 1}),
        "Emissive": (pr.Emissive, {"radiance": 1}),
        "EnvironmentLight": (pr.EnvironmentLight, {}),
        "Mirror": (pr.Mirror, {}),
        "Model": (pr.Model, {"points": t.rows[:100], "smooth": 0.5}),
        "Model.load": (pr.Model.load, {"path": t.folder / "a.pointray", "memory": 1 << 30}),
        "Model.make_levels": (pr.Model(t.points).make_levels, {}),
        "Model.rebuild": (t.model.rebuild, {"smooth": 0, "surface": "imls"}),
        "Model.to_mesh": (t.model.to_mesh, {"resolution": 10}),
        "Model.save": (t.model.save, {"path": t.folder / "b.pointray"}),
        "Phong": (pr.Phong, {}),
        "Plane": (pr.Plane, {"point": (0, 0, -1), "normal": (0, 0, 1)}),
        "PointLight": (pr.PointLight, {"position": (0, 0, 3), "intensity": 1}),
        "Points": (pr.Points, {"positions": t.rows}),
        "Points.about": (pr.Points.about, {"origin": (0, 0, 0), "positions": t.rows.astype(np.float32)}),
        "Points.select": (t.points.select, {"rows": np.arange(5)}),
        "Points.with_normals": (t.points.with_normals, {"normals": t.rows}),
        "Principled": (pr.Principled, {}),
        "RectLight": (pr.RectLight, {"center": (0, 0, 3), "u": (0, 1, 0), "v": (1, 0, 0), "radiance": 1}),
        "Scene": (pr.Scene, {}),
        "Scene.add": (scene.add, {"shape": t.model}),
        "Scene.add_light": (lambda light: t.changed().add_light(light), {"light": pr.SunLight((0, 0, -1))}),
        "Scene.background": (lambda background: setattr(scene, "background", background), {"background": 1}),
        "Scene.baked": (lambda baked: setattr(scene, "baked", baked), {"baked": None}),
        "Scene.clips": (lambda clips: setattr(scene, "clips", clips), {"clips": []}),
        "Scene.exchange": (t.scene.exchange, {"models": {}}),
        "Scene.intersect": (t.scene.intersect, rays),
        "Scene.lights": (lambda lights: setattr(scene, "lights", lights), {"lights": []}),
        "Scene.occluded": (t.scene.occluded, rays),
        "Scene.remove": (lambda id: t.changed().remove(id), {"id": 0}),
        "Scene.update": (scene.update, {"id": 0}),
        "Settings": (pr.Settings, {}),
        "SphereLight": (pr.SphereLight, {"center": (0, 0, 3), "radius": 1, "radiance": 1}),
        "Georeference": (pr.Georeference, {"scale": (1, 1, 1), "offset": (0, 0, 0)}),
        "SunLight": (pr.SunLight, {"direction": (0, 0, -1)}),
        "Trajectory": (pr.Trajectory, {"times": (1, 2), "positions": np.eye(3)[:2]}),
        "animate": (lambda **given: list(pr.animate(**given)), {"scene": t.scene, "cameras": [t.camera]}),
        "BakeSettings": (pr.BakeSettings, {}),
        "bake": (pr.bake, {"scene": t.lit, "settings": pr.BakeSettings(links=1, patches=64)}),
        "as_points": (pr.as_points, {"x": t.rows}),
        "clean": (pr.clean, {"points": t.points}),
        "draw_legend": (
            pr.draw_legend,
            {"image": np.zeros((64, 64, 3), np.float32), "attribute": pr.Attribute("height", range=(0, 1))},
        ),
        "check_normals": (pr.check_normals, {"points": t.points}),
        "estimate_normals": (pr.estimate_normals, {"points": t.points}),
        "formats": (pr.formats, {}),
        "eyes_along": (pr.eyes_along, {"points": t.timed, "trajectory": t.trajectory}),
        "find_flaws": (pr.find_flaws, {"points": t.points}),
        "find_strays": (pr.find_strays, {"points": t.points}),
        "merge_layers": (pr.merge_layers, {"points": t.points}),
        "smooth": (pr.smooth, {"points": t.points}),
        "fly": (pr.fly, {"keys": [(0, t.camera), (0.1, t.camera)]}),
        "frame": (pr.frame, {"subject": t.points}),
        "load_scene": (pr.load_scene, {"path": t.folder / "a.toml"}),
        "prepare": (t.prepare, {"paths": t.folder / "a.ply"}),
        "procedural": (pr.procedural, {"name": "sphere", "n": 10}),
        "procedural_distance": (pr.procedural_distance, {"name": "sphere", "x": (0, 0, 1)}),
        "read": (pr.read, {"path": t.folder / "a.ply"}),
        "render": (pr.render, {"scene": t.scene, "camera": t.camera}),
        "render_layers": (pr.render_layers, {"scene": t.scene, "camera": t.camera}),
        "studio": (pr.studio, {}),
        "subsample": (pr.subsample, {"points": t.points.select(np.arange(100)), "count": 60}),
        "transform": (pr.transform, {}),
        "turntable": (pr.turntable, {"camera": t.camera, "frames": 3}),
        "view": (
            lambda **given: pr.view(**{"open_browser": False, **given}).close(),
            {"scene": t.scene, "block": False},
        ),
        "ViewerWidget": (pr.ViewerWidget, {"scene": t.scene}),
        "ViewerWidget.camera": (lambda camera: setattr(widget, "camera", camera), {"camera": t.camera}),
        "ViewerWidget.snapshot": (widget.snapshot, {"size": (8, 8), "samples": 1}),
        "write": (pr.write, {"path": t.folder / "b.ply", "points": t.points}),
        "write_image": (pr.write_image, {"path": t.folder / "b.png", "image": np.zeros((4, 4, 3), np.float32)}),
        "write_splats": (pr.write_splats, {"path": t.folder / "b.splat", "subject": t.points.changed(attributes={})}),
        "write_layers": (pr.write_layers, {"path": t.folder / "b.npz", "layers": {"depth": np.zeros((4, 4))}}),
    }


# A parameter that excludes another needs the other left out.
INSTEAD = {("subsample", "tolerance"): ("count",)}


def parameters(function: Callable[..., Any], without: int = 0) -> dict[str, str]:
    """Names and annotations, without the first ones."""
    found = list(inspect.signature(function).parameters.values())[without:]
    return {p.name: str(p.annotation) for p in found if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)}


def public() -> Iterator[tuple[str, dict[str, str]]]:
    """Functions, classes, methods and properties that can be set: their names and parameters."""
    for name in pr.__all__:
        thing = getattr(pr, name)
        if name in RESULTS or not callable(thing):
            continue
        yield name, parameters(thing)
        members = vars(thing).items() if inspect.isclass(thing) else ()
        for member, value in members:
            if member.startswith("_") or (value.__doc__ or "").startswith("Deprecated alias"):
                continue
            if isinstance(value, property) and value.fset is not None:
                yield f"{name}.{member}", {member: next(iter(parameters(value.fset, 1).values()))}
            elif isinstance(value, classmethod) or inspect.isfunction(value):
                given = parameters(getattr(value, "__func__", value), 1)
                if given:
                    yield f"{name}.{member}", given


PUBLIC = dict(public())


@pytest.fixture(scope="module")
def calls(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Call]:
    """Valid calls, each made once, so that all kernels are compiled."""
    things = Things(tmp_path_factory.mktemp("arguments"))
    made = valid_calls(things)
    for function, given in made.values():
        function(**given)
    return made


@pytest.fixture(autouse=True)
def nobody_waits(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No browser is opened, nothing waits for Ctrl-C, and files go to an empty folder."""
    monkeypatch.setattr(pr.Viewer, "wait", lambda self, *_: None)
    monkeypatch.setattr(pr.Viewer, "open_browser", lambda self: True)
    monkeypatch.chdir(tmp_path)


def test_every_public_callable_has_a_valid_call(calls: Mapping[str, Call]) -> None:
    assert set(calls) >= set(PUBLIC), "say in `valid_calls` how these are called, or in RESULTS that nobody does"
    assert set(calls) <= set(PUBLIC) | {"Scene"}


def kinds_of(annotation: str) -> set[str]:
    """The alternatives of an annotation, without their brackets."""
    plain = annotation
    while "[" in plain:
        plain = re.sub(r"\[[^][]*\]", "", plain)
    return {kind.strip() for kind in plain.split("|")}


CASES = [(name, parameter) for name, given in PUBLIC.items() for parameter in given]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("name", "parameter"), CASES, ids=lambda x: x)
def test_wrong_values_are_refused_by_name_or_make_sense(
    calls: Mapping[str, Call], name: str, parameter: str, capsys: pytest.CaptureFixture[str]
) -> None:
    function, given = calls[name]
    left = {key: value for key, value in given.items() if key not in INSTEAD.get((name, parameter), ())}
    kinds = kinds_of(PUBLIC[name][parameter])
    assert kinds <= set(SENSE), "say in SENSE what such a parameter may be"
    sense = set().union(*(SENSE[kind] for kind in kinds))
    before, bad = compilations(), []
    for what, value in WRONG.items():
        try:
            function(**{**left, parameter: value})
        except ValueError as error:
            shown = str(value) if parameter in PATHS and isinstance(value, str) else parameter
            if not re.search(rf"\b({parameter}|{re.escape(shown)})\b", str(error)):
                bad.append(f"{what}: the message does not name {parameter}: {error}")
            if what == "lambda" and not kinds & ARRAY_KINDS and not isinstance(error, TypeError):
                bad.append(f"{what}: a wrong type raises {type(error).__name__}: {error}")
        except OSError as error:
            if parameter not in PATHS or what not in TEXTS:
                bad.append(f"{what}: {type(error).__name__}: {error}")
        except Exception as error:  # the parameter's name
            bad.append(f"{what}: {type(error).__name__}: {error}")
        else:
            if what not in sense:
                bad.append(f"{what}: was taken")
    assert not bad, "\n".join(["", *bad])
    assert compilations() == before


def test_numbers_of_numpy_are_numbers_and_become_those_of_python() -> None:
    """NumPy's type of number would compile a kernel anew."""
    settings = pr.Settings(spp=np.int32(2), seed=np.array(3), max_depth=np.uint8(1), noise=np.float32(0.5))  # type: ignore[arg-type]
    assert [type(x) for x in (settings.spp, settings.seed, settings.max_depth, settings.noise)] == [int] * 3 + [float]
    assert pr.Settings(shadows=np.bool_(False)).shadows is False
    camera = pr.Camera((0, 0, 0), np.ones(3), fov=np.array(30), size=np.array([8, 6]), focus=np.float32(2))  # type: ignore[arg-type]
    assert camera == pr.Camera((0, 0, 0), (1, 1, 1), fov=30.0, size=(8, 6), focus=2.0)
    assert [type(x) for x in (camera.fov, *camera.size, camera.focus, *camera.target)] == [float, int, int] + [
        float
    ] * 4
    np.testing.assert_array_equal(
        pr.transform(rotate=np.array(90.0), scale=np.int8(2)), pr.transform(rotate=90, scale=2)
    )
    assert (pr.PointLight(np.zeros(3), np.float32(2)).record() == pr.PointLight((0, 0, 0), 2).record()).all()
    assert (pr.Phong(exponent=np.array(7)).record() == pr.Phong(exponent=7).record()).all()
