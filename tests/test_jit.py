"""The engine room: vectors against NumPy, the disk cache, the thread loop; and who imports what."""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pointray
from pointray import jit
from pointray.jit import kernel, run, take
from pointray.simd import (
    bits,
    lane,
    load16,
    lowest,
    pack,
    quarters,
    repeat4,
    select,
    shift_quarter,
    spread16,
    store,
    sum_quarters,
    vabs,
    vmax,
    vmin,
)

PACKAGE = Path(pointray.__file__).parent


@kernel
def _vectors(a, numbers, out):
    v, w = load16(a, 0), repeat4(a, 4)
    q = quarters(np.float32(1), np.float32(2), np.float32(3), np.float32(4))
    x = v * 2.0 + w / q - 1
    mask = (x > 5.0) & (x < 20)
    store(out, 0, x)
    store(out, 16, sum_quarters(x))
    store(out, 32, shift_quarter(q, x))
    store(out, 48, vmax(vmin(x, 5.0), q))
    store(out, 64, select(mask, vabs(x - 9), spread16(np.float32(0))))
    found = np.zeros(16, np.int32)
    return bits(mask), lane(x, 3), lowest(bits(mask)), pack(mask, numbers, 0, found, 0), found


def test_vectors_are_numpy():
    a, out, numbers = np.arange(32, dtype=np.float32), np.zeros(80, np.float32), np.arange(100, 116, dtype=np.int32)
    word, third, first, count, found = _vectors(a, numbers, out)
    q = np.repeat([1, 2, 3, 4], 4).astype(np.float32)
    x = a[:16] * 2 + np.tile(a[4:8], 4) / q - 1
    mask = (x > 5) & (x < 20)
    want = [x, np.repeat(x.reshape(4, 4).sum(1), 4), np.concatenate([q[12:], x[:12]]), np.maximum(np.minimum(x, 5), q)]
    assert out == pytest.approx(np.concatenate([*want, np.where(mask, np.abs(x - 9), 0)]))
    assert word == (mask << np.arange(16)).sum() and third == x[3] and first == np.flatnonzero(mask)[0]
    assert found[:count].tolist() == numbers[mask].tolist()


@kernel
def _count(work, out):
    t = take(work)
    while t >= 0:
        out[t] += 1
        t = take(work)
    return 0


@pytest.mark.parametrize("threads", [1, 2, 7])
def test_each_tile_is_taken_once(threads):
    out = np.zeros(10_000)
    run(_count, len(out), out, threads=threads)
    assert (out == 1).all()


def test_an_error_in_a_worker_is_raised():
    def broken(work):
        raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        run(broken, 4, threads=2)


@pytest.mark.skipif(not jit.CHECK, reason="needs POINTRAY_CHECK=1")
def test_a_load_beyond_the_end_is_noticed():
    with pytest.raises(IndexError):
        _vectors(np.zeros(15, np.float32), np.zeros(16, np.int32), np.zeros(80, np.float32))


@pytest.mark.parametrize("text", ["0", "-1", "many"])
def test_threads_are_checked(monkeypatch, text):
    monkeypatch.setenv("POINTRAY_THREADS", text)
    with pytest.raises(ValueError, match="threads|POINTRAY_THREADS"):
        jit.thread_count()


USE = """
import sys
from pointray import jit, vec
@jit.kernel
def use(x):
    return vec.length((x, 0.0, 4.0))
print(use(3.0), jit.compilations())
"""


def use(folder: Path, cache: Path) -> list[str]:
    """What a kernel that calls `vec.length` gives, and how many kernels were compiled, in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "POINTRAY_CACHE": str(cache)}
    script = folder / "use.py"
    script.write_text(USE)
    done = subprocess.run([sys.executable, script], env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_the_cache_serves_the_second_process_and_never_runs_stale_code(tmp_path):
    copy, cache = tmp_path / "copy", tmp_path / "cache"
    copy.mkdir()
    shutil.copytree(PACKAGE, copy / "pointray", ignore=shutil.ignore_patterns("__pycache__"))
    assert use(copy, cache) == ["5.0", "1"]
    assert use(copy, cache) == ["5.0", "0"]
    vec = copy / "pointray" / "vec.py"
    vec.write_text(vec.read_text().replace("return math.sqrt(dot(a, a))", "return 2.0 * math.sqrt(dot(a, a))"))
    assert use(copy, cache) == ["10.0", "1"]
    for file in cache.rglob("*.nbc"):
        file.write_bytes(file.read_bytes()[:100])
    assert use(copy, cache) == ["10.0", "1"]


def test_a_cache_folder_that_cannot_be_written_is_no_error(tmp_path):
    file = tmp_path / "file"
    file.write_text("in the way")
    shutil.copytree(PACKAGE, tmp_path / "pointray", ignore=shutil.ignore_patterns("__pycache__"))
    assert use(tmp_path, file / "cache") == ["5.0", "1"]


STAGES = ["points", "splats", "tree", "trace", "shade", "image"]


def imports(path: Path) -> list[str]:
    """Modules that a file of the package imports, as 'pointray.x' or absolute names."""
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
            base = ".".join(parts[: len(parts) - node.level]) + "." if node.level else ""
            found.append(base + (node.module or ""))
    return found


def test_only_the_engine_imports_numba():
    users = {p.name for p in PACKAGE.rglob("*.py") if any(m.split(".")[0] in ("numba", "llvmlite") for m in imports(p))}
    assert users == {"jit.py", "simd.py"}


def test_a_stage_imports_only_what_stands_above_it():
    for k, stage in enumerate(STAGES[:4]):
        below = [f"pointray.{name}" for name in (*STAGES[k + 1 : 5], "model", "scene", "picture", "cli")]
        for path in (PACKAGE / stage).rglob("*.py"):
            wrong = [m for m in imports(path) if any(m == b or m.startswith(b + ".") for b in below)]
            assert not wrong, f"{path.name} imports {wrong}"


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, pointray; print([m for m in ('numba', 'scipy', 'PIL') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_is_there():
    for name in pointray.__all__:
        assert getattr(pointray, name) is not None
    assert callable(pointray.render)
