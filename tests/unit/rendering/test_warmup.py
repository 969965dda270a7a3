"""Compilation of kernels in another process before they are needed, and the messages about it."""

import json
import os
import shutil
import subprocess
import sys
import time

import pytest

import pointray as pr
from helpers.kernel_cache import linked_cache
from helpers.places import ROOT
from pointray.engine import jit
from pointray.engine.jit import backlog, second_process as beside
from pointray.engine.jit.backlog import Backlog
from pointray.rendering import warmup
from pointray.viewer.time_left import TimeLeft


class Clock:
    """A clock that tests advance."""

    def __init__(self, monkeypatch):
        self.now = 100.0
        monkeypatch.setattr(time, "perf_counter", lambda: self.now)


@pytest.fixture
def clock(monkeypatch):
    return Clock(monkeypatch)


def test_the_backlog_reports_the_kernel_and_the_time_left(clock):
    """Two queues run at once: the time left is that of the longer one, at the speed measured so far."""
    work = Backlog()
    assert work.state is None
    work.expect({"a": 4.0, "b": 6.0})
    work.expect({"c": 20.0}, in_second_process=True)
    assert work.state is None
    work.begin("a")
    work.begin("c", in_second_process=True)
    assert work.state == (1, 3, 0.0, 20.0)
    clock.now += 8.0
    assert work.state == (1, 3, pytest.approx(8 / (8 + 12)), 12.0)
    work.end("a")  # twice as slow as expected
    number, total, _, seconds = work.state
    assert (number, total) == (2, 3) and seconds == pytest.approx(2 * 20 - 8)
    work.end("c", in_second_process=True)
    assert work.state is None  # nothing is being compiled
    work.begin("b")
    work.begin("unknown")
    assert work.state.total == 4
    clock.now += 1000.0
    assert 0 < work.state.seconds < 10 and work.state.share < 1
    work.drop(["b", "unknown"])
    assert work.state is None


def test_an_unexpected_kernel_is_counted(clock):
    work = Backlog()
    work.begin("a")
    assert work.state == (1, 1, 0.0, backlog.UNKNOWN)
    work.end("a")
    work.begin("b")
    assert (work.state.number, work.state.total) == (2, 2)


def test_time_left_is_estimated_per_stage(clock):
    left = TimeLeft()
    assert left("radii", 0.0) is None
    clock.now += 0.5
    assert left("radii", 0.1) is None  # too early for an estimate
    clock.now += 1.5
    assert left("radii", 0.2) == pytest.approx(8.0)
    assert left("tree", 0.5) is None
    clock.now += 10.0
    assert left("tree", 0.75) == pytest.approx(10.0)
    assert left("tree", None) is None and left("tree", 0.1) is None  # started again


@pytest.mark.long
@pytest.mark.parametrize("start", ["first_start", "other_start"])
def test_the_record_contains_the_kernels_of_a_first_start(start):
    """If this fails after a change of building, pictures or baking, run `record_kernels`."""
    command = [sys.executable, ROOT / "bench" / "maintenance" / "record_kernels.py", start]
    rows = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    record = {stage: {f"pointray.{name}" for name in kernels} for stage, kernels in stages().items()}
    if start == "first_start":
        assert set(rows.pop("normals")) == record.pop("build") | record.pop("normals")
        assert {stage: set(kernels) for stage, kernels in rows.items()} == record
    else:  # points have normals
        assert set(rows) > record["build"] and not set(rows) & record["normals"]


def stages():
    """Return the kernels of each stage, with their compile times in seconds."""
    return {stage: kernels for stage, kernels in warmup.RECORD.items() if stage != "shared"}


def test_the_record_names_existing_kernels():
    for kernels in stages().values():
        assert kernels
        for name, seconds in kernels.items():
            assert f"pointray.{name}" in jit.KERNELS and seconds > 0


COLD = """
import sys, threading, time
import pointray as pr
sys.path.append({root!r})
from bench.maintenance.record_kernels import torus
from pointray.rendering import warmup
from pointray.engine.jit import BACKLOG, compilations

def watch():
    while True:
        seen.append(BACKLOG.state)
        time.sleep(0.005)

if __name__ == "__main__":
    seen = []
    warmup.warm_up(pr.Settings("normal"), clicks=True)
    threading.Thread(target=watch, daemon=True).start()
    scene = pr.Scene()
    scene.add(pr.Model(torus()))
    scene.add(pr.Plane((0, 0, -1), (0, 0, 1)))
    hit = scene.intersect([1, 0, 5], [0, 0, -1])
    states = [state for state in seen if state]
    print(compilations(), max([state.total for state in states], default=0), BACKLOG.state, hit.t > 0)
    print(all(a.number <= b.number for a, b in zip(states, states[1:])))
""".replace("{root!r}", repr(str(ROOT)))
PICTURE = """
    pr.render(scene, pr.Camera.look_at((3, 0, 2), (0, 0, 0), size=(8, 8)), pr.Settings("normal"))
"""
CHEAP = ["cloud.neighbors.rows", "surface.tree.wide"]  # modules with the kernels of a model that compile fastest


def run(program, cache):
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "POINTRAY_CACHE": str(cache), "POINTRAY_KERNELS": "jit"},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.splitlines()


@pytest.mark.long
def test_all_kernels_compiled_on_a_first_start_were_expected(tmp_path):
    """Some kernels are not cached, and a second process compiles one of them; on the next start all are cached."""
    cache = linked_cache(tmp_path / "cache")
    run(COLD + PICTURE, cache)
    missing = [*CHEAP, "surface.trace.cast"]
    folders = [folder for name in missing for folder in cache.glob(f"*/{name}-*")]
    assert {folder.name.rsplit("-", 1)[0] for folder in folders} >= set(CHEAP)
    for folder in folders:
        shutil.rmtree(folder)
    count = sum(name.rsplit(".", 1)[0] in missing for name in [*warmup.BUILD, warmup.CLICK])
    assert run(COLD, cache) == [f"{count} {count} None True", "True"]
    assert run(COLD, cache) == ["0 0 None True", "True"]


@pytest.fixture
def uncompiled(monkeypatch):
    """A kernel that is treated as not compiled."""
    monkeypatch.setattr(jit.Kernel, "is_compiled", False)
    return "pointray.surface.trace.cast._closest"


@pytest.mark.parametrize("program", ["raise SystemExit(3)", "print('pointray.no.such')", "print('\\xff' * 9)"])
def test_processes_do_not_wait_if_the_compiler_process_fails(tmp_path, monkeypatch, uncompiled, program):
    (tmp_path / "sad_module.py").write_text(program)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    scene = pr.Scene()
    scene.add(pr.Plane((0, 0, 0), (0, 0, 1)))
    jit.compile_in_background("sad_module", {uncompiled: 1.0})
    assert scene.intersect((0, 0, 2), (0, 0, -1)).t == 2.0
    assert uncompiled not in beside._pending and jit.BACKLOG.state is None


def test_waiting_threads_are_notified_and_may_give_up(tmp_path, monkeypatch, uncompiled):
    may_end = tmp_path / "may end"
    (tmp_path / "slow_module.py").write_text(
        "import os, time\n"
        f"while not os.path.exists({str(may_end)!r}):\n"
        "    time.sleep(0.01)\n"
        f"print({uncompiled!r}, flush=True)\n"
        "input()\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    jit.compile_in_background("slow_module", {uncompiled: 1.0})
    kernel = jit.KERNELS[uncompiled]
    assert not jit.wait_for(kernel, lambda: True)
    assert jit.BACKLOG.state is not None
    before = jit.compile_seconds()
    assert jit.wait_for(kernel, lambda: bool(may_end.touch()))
    assert jit.compile_seconds() > before
    assert jit.wait_for(jit.KERNELS["pointray.rendering.integrate.quick_frame"], lambda: True)  # nobody compiles it


@pytest.mark.long
def test_the_compiler_process_ends_with_its_parent(tmp_path):
    """If its parent is killed, no process continues to compile."""
    script = (
        "import os, time; from pointray.engine.jit import Kernel; Kernel.is_compiled = False; "
        "from pointray.rendering import warmup; import subprocess; real = subprocess.Popen\n"
        "def start(*words, **options):\n"
        "    process = real(*words, **options)\n"
        "    print(process.pid, flush=True)\n"
        "    return process\n"
        "subprocess.Popen = start\n"
        "warmup.warm_up(__import__('pointray').Settings())\n"
        "time.sleep(1)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    environment = {**os.environ, "POINTRAY_CACHE": str(tmp_path), "POINTRAY_KERNELS": "jit"}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == -9
    pid = int(done.stdout)
    end = time.monotonic() + 120
    while is_alive(pid):
        assert time.monotonic() < end, "it goes on"
        time.sleep(0.1)


def is_alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False
