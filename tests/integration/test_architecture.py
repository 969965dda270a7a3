"""Rules for imports: order of rooms, who may import Numba and Dask, and no cycles."""

import graphlib
import importlib
import inspect
import pickle
import re
import subprocess
import sys
from inspect import isfunction
from types import ModuleType

import pytest

import pointray
from helpers.architecture import FILES, FLOORS, PACKAGE, TOWER, arrows, upwards, users_of, within


def test_every_room_has_a_place_in_the_order():
    assert {name.split(".")[0] for name in arrows()} <= set(TOWER)


def test_every_import_points_down():
    assert upwards(TOWER, arrows()) == []
    assert upwards(["io", "cli"], {"io.files": {"cli.view", "os"}}) == [("io.files", "cli.view")]


@pytest.mark.parametrize("room", FLOORS)
def test_imports_inside_of_a_room_point_down(room):
    inside = within(room, arrows())
    assert {*FLOORS[room]} <= {name.split(".")[0] for name in inside}
    assert upwards(FLOORS[room], inside) == []


def test_the_package_has_few_top_level_entries():
    files = {"__init__.py", "__init__.pyi", "__main__.py", "__pycache__", "py.typed"}
    entries = {path.name for path in PACKAGE.iterdir()} - files
    assert entries == {*TOWER} - {"__main__"} and len(entries) <= 18


def test_imports_have_no_cycles():
    graphlib.TopologicalSorter({name: others & FILES.keys() for name, others in arrows().items()}).prepare()


def test_only_the_engine_imports_numba():
    users = users_of("numba", "llvmlite")
    assert {".".join(name.split(".")[:2]) for name in users} == {"engine.jit", "engine.simd"}


def test_only_the_cluster_and_higher_rooms_import_the_cluster():
    users = {name.split(".")[0] for name, others in arrows().items() if any(o.startswith("cluster.") for o in others)}
    assert users <= {"cluster", "viewer", "cli"}
    assert {name.split(".")[0] for name in users_of("dask", "distributed")} == {"cluster"}


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, pointray; print([m for m in ('numba', 'scipy', 'PIL') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_exists():
    assert {"NormalsCheck", "Strays", "Viewer", "prepare", "__version__"} <= {*pointray.__all__} == {*dir(pointray)}
    for name in pointray.__all__:
        value = getattr(pointray, name)
        assert value.__doc__ and not isinstance(value, ModuleType)
        if isinstance(value, type):
            assert pickle.loads(pickle.dumps(value)) is value


def test_modules_do_not_hide_public_names():
    for module in ("cloud.denoising.smooth", "io.formats", "model.preparation", "procedural_models", "viewer"):
        importlib.import_module(f"pointray.{module}")
    names = pointray.smooth, pointray.formats, pointray.procedural, pointray.prepare, pointray.view
    assert all(isfunction(value) for value in names)


def test_a_star_imports_all_public_names():
    names = {}
    exec("from pointray import *", names)
    assert names.keys() >= {*pointray.__all__}


@pytest.mark.parametrize(
    ("name", "words"),
    [("rendr", ": did you mean 'render'?"), ("sunlight", ": did you mean 'SunLight'?"), ("qqq", ""), ("__file", "")],
)
def test_a_misspelt_name_has_a_suggestion(name, words):
    with pytest.raises(AttributeError) as caught:
        getattr(pointray, name)
    assert str(caught.value) == f"module 'pointray' has no attribute {name!r}{words}"


def test_the_classes_of_results_are_public():
    """Those that the public functions return."""
    functions = [value for value in vars(pointray).values() if isfunction(value) and value.__name__ in pointray.__all__]
    known = {*pointray.__all__, "Any", "Iterator", "Light", "NDArray", "None"}  # Light: one of several
    for function in functions:
        named = set(re.findall(r"\b[A-Z]\w+", str(inspect.signature(function).return_annotation)))
        assert named <= known, function
