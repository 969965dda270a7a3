"""Rules for imports: order of rooms, who may import Numba and Dask, and no cycles."""

import graphlib
import subprocess
import sys

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
    entries = {path.name for path in PACKAGE.iterdir()} - {"__init__.py", "__main__.py", "__pycache__", "py.typed"}
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
    for name in pointray.__all__:
        assert getattr(pointray, name) is not None
    assert callable(pointray.render)
