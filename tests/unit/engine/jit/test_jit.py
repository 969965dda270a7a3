"""Kernels: the disk cache and the thread loop."""

import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import pointray
from pointray.engine import jit
from pointray.engine.jit import Cancel, borrow, disk_cache as disk, keep_alive, kernel, next_tile, run

PACKAGE = Path(pointray.__file__).parent


@kernel
def _count(work, out):
    t = next_tile(work)
    while t >= 0:
        out[t] += 1
        t = next_tile(work)
    return 0


@pytest.mark.parametrize("threads", [1, 2, 7])
def test_each_tile_is_processed_once(threads):
    out = np.zeros(10_000)
    run(_count, len(out), out, threads=threads)
    assert (out == 1).all()


class Inner(NamedTuple):
    values: np.ndarray
    factor: int


class Outer(NamedTuple):
    inner: Inner
    more: np.ndarray
    pair: tuple


@kernel
def _sum_borrowed(outer):
    memory = np.full(3, 7.0)
    lent = borrow(outer)
    mine = borrow(memory)
    total = lent.inner.factor * lent.inner.values.sum() + lent.more.sum() + lent.pair[1] + mine.sum()
    keep_alive(memory)
    return total


def test_a_record_is_borrowed_with_all_its_fields():
    outer = Outer(Inner(np.arange(4.0), 3), np.ones(5, np.int64), (1, 2))
    assert _sum_borrowed(outer) == 3 * 6 + 5 + 2 + 21
    assert sys.getrefcount(outer.more) == sys.getrefcount(outer.inner.values)


def test_an_error_in_a_worker_is_raised():
    def broken(work):
        raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        run(broken, 4, threads=2)


@kernel
def _slow(work, out):
    t = next_tile(work)
    while t >= 0:
        x = 1.0
        for _ in range(1_000_000):
            x = (x * 1.1) % 7.0
        out[t] = x
        t = next_tile(work)
    return 0


def test_a_run_is_cancelled_between_two_tiles():
    out, cancel = np.zeros(10_000), Cancel()
    run(_slow, 2, out)  # compiled
    out[:] = 0.0

    def cancel_after_the_first():
        while not out.any():
            time.sleep(0.001)
        cancel()

    thread = threading.Thread(target=cancel_after_the_first)
    thread.start()
    run(_slow, len(out), out, threads=2, cancel=cancel)
    thread.join()
    count = np.count_nonzero(out)
    assert 1 <= count < len(out)  # all of them would take minutes
    run(_slow, len(out), out, threads=2, cancel=cancel)  # cancelled before it starts
    assert np.count_nonzero(out) == count


@pytest.mark.parametrize("text", ["0", "-1", "many"])
def test_threads_are_checked(monkeypatch, text):
    monkeypatch.setenv("POINTRAY_THREADS", text)
    with pytest.raises(ValueError, match="threads|POINTRAY_THREADS"):
        jit.thread_count()


USE = """
import sys
from pointray.engine import jit
from pointray.engine.kernels import vec
@jit.kernel
def use(x):
    return vec.length((x, 0.0, 4.0))
print(use(3.0), jit.compilations())
"""


TOGETHER = """
import os, sys
from pointray.engine import jit
@jit.kernel
def tiny(x):
    return 2.0 * x
begin, go = os.pipe()
children = []
for _ in range(int(sys.argv[1])):
    child = os.fork()
    if not child:
        os.close(go)
        os.read(begin, 1)  # until the other end is closed
        print(f"{tiny(3.0)} {jit.compilations()}", flush=True)
        os._exit(0)
    children.append(child)
os.close(go)
assert all(os.waitpid(child, 0)[1] == 0 for child in children)
"""


def use(folder: Path, cache: Path, program: str = USE, *arguments: str) -> list[str]:
    """Run a kernel that calls `vec.length` in its own process; returns its result and how many kernels it compiled."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "POINTRAY_CACHE": str(cache), "POINTRAY_KERNELS": "jit"}
    script = folder / "use.py"
    script.write_text(program)
    command = [sys.executable, script, *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split()


def copied(folder):
    """Copy the package into a folder, with its bytecode, which would take a second to make."""
    shutil.copytree(PACKAGE, folder / "pointray")
    return folder


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory):
    """A copy of the package, which no test changes."""
    return copied(tmp_path_factory.mktemp("copy"))


@pytest.mark.long
def test_a_second_process_uses_the_cache_and_never_stale_code(tmp_path):
    copy, cache = copied(tmp_path / "copy"), tmp_path / "cache"
    assert use(copy, cache) == ["5.0", "1"]
    assert use(copy, cache) == ["5.0", "0"]
    vec = copy / "pointray" / "engine/kernels/vec.py"
    vec.write_text(vec.read_text().replace("return math.sqrt(dot(a, a))", "return 2.0 * math.sqrt(dot(a, a))"))
    assert use(copy, cache) == ["10.0", "1"]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_only_one_of_several_processes_compiles_a_kernel(elsewhere, tmp_path):
    """They start together with an empty cache: the others wait for the first one and load its kernel."""
    output = use(elsewhere, tmp_path / "cache", TOGETHER, "4")
    assert output[::2] == ["6.0"] * 4
    assert sum(map(int, output[1::2])) == 1


SCREEN = """
import numpy as np
from pointray.image.screen import _to_8bit, to_8bit
from pointray.engine.jit import compilations
before = _to_8bit.is_compiled
to_8bit(np.zeros((4, 4, 4), np.float32), np.zeros((4, 3)), 0.0, "srgb")
print(before, compilations())
"""


@pytest.mark.long
def test_an_edit_of_a_kernels_own_file_compiles_only_that_and_is_reported(tmp_path):
    copy, cache = copied(tmp_path / "copy"), tmp_path / "cache"
    assert use(copy, cache, SCREEN) == ["False", "1"] and use(copy, cache, SCREEN) == ["True", "0"]
    for file, known in (("image/screen.py", False), ("cli/options.py", True), ("io/formats/ply/ply.py", True)):
        path = copy / "pointray" / file
        path.write_text(path.read_text() + "# edited\n")
        assert use(copy, cache, SCREEN) == [str(known), str(int(not known))]


def test_a_cache_folder_that_is_not_writable_is_not_used(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("POINTRAY_CACHE", str(tmp_path / "file" / "cache"))
    assert disk.cache_folder.__wrapped__() is None


@pytest.mark.long
def test_a_cache_folder_that_is_not_writable_is_no_error(elsewhere, tmp_path):
    file = tmp_path / "file"
    file.write_text("in the way")
    assert use(elsewhere, file / "cache") == ["5.0", "1"]


CALLS = """
import numpy as np
from pointray.engine import jit
@jit.routine
def far_away(x, k):
    return x[k] * x[k + 1]
@jit.inline
def both(x, k):
    return far_away(x, 0) - far_away(x, k)
@jit.kernel
def differ(x):
    return both(x, 2) + both(x, int(x[0]))
print(differ(np.arange(1.0, 9.0)), len(far_away.dispatcher.overloads), len(both.dispatcher.overloads))
(code,) = differ.dispatcher.inspect_llvm().values()
defined = [line for line in code.splitlines() if line.startswith("define")]
print(sum("far_away" in line for line in defined), sum("both" in line for line in defined))
"""


@pytest.mark.long
def test_a_routine_is_compiled_once_and_an_inline_function_never(elsewhere, tmp_path):
    """The routine is called with and without constants, and from an inline, whose options Numba passes on."""
    assert use(elsewhere, tmp_path / "cache", CALLS) == [str(2.0 - 12.0 + 2.0 - 6.0), "1", "1", "1", "0"]


@pytest.mark.long
def test_a_damaged_index_of_the_cache_is_no_error(elsewhere, tmp_path):
    """A damaged kernel is compiled again, and the next process uses the result."""
    assert use(elsewhere, tmp_path) == ["5.0", "1"]
    for ending in ("nbi", "nbc"):
        for file in tmp_path.rglob(f"*.{ending}"):
            file.write_bytes(file.read_bytes()[:100])
        assert use(elsewhere, tmp_path) == ["5.0", "1"], ending
    assert use(elsewhere, tmp_path) == ["5.0", "0"]


PIECE = """
from pointray.engine import jit
@jit.inline
def piece(x):
    return x * 2.0
@jit.kernel
def use(x):
    return piece(x)
print(use(3.0), jit.compilations())
"""


@pytest.mark.long
def test_an_edit_of_a_kernel_outside_the_package_is_noticed(elsewhere, tmp_path):
    """References in tests/helpers/naive.py are such kernels: a stale one would be outdated."""
    assert use(elsewhere, tmp_path, PIECE) == ["6.0", "1"]
    assert use(elsewhere, tmp_path, PIECE.replace("2.0", "7.0")) == ["21.0", "1"]


def test_only_marked_folders_are_pruned(tmp_path):
    """Folders with similar names or another mark are kept, and so are the newest."""
    foreign = [tmp_path / "kernels-of-my-own", tmp_path / "kernels-0000000000000000", tmp_path / "kernels-x"]
    ours = [tmp_path / f"kernels-{k:016x}" for k in range(1, 8)]
    for age, folder in enumerate([*foreign, *ours]):
        folder.mkdir()
        (folder / "a.nbc").touch()
        if folder in ours:
            (folder / disk.MARK).write_bytes(disk.MARKED)
        os.utime(folder, (1e9 + age, 1e9 + age))
    (foreign[2] / disk.MARK).write_text("another's")
    (tmp_path / "kernels-notes.txt").touch()
    code = "from pointray.engine.jit.disk_cache import cache_folder; print(cache_folder())"
    environment = {**os.environ, "POINTRAY_CACHE": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    new = Path(done.stdout.strip())
    assert (new / disk.MARK).read_bytes() == disk.MARKED
    kept = [*foreign, *ours[-disk.KEEP_CACHES :], new, tmp_path / "kernels-notes.txt"]
    assert sorted(tmp_path.iterdir()) == sorted(kept)


SQUARES = jit.Table(lambda: np.arange(5.0) ** 2)


@kernel
def _square(k):
    return SQUARES[k]


def test_a_table_is_an_array_of_kernels():
    assert [_square(k) for k in range(5)] == [0, 1, 4, 9, 16]
    assert jit.Table(lambda: np.arange(3))[2] == 2


def test_a_table_of_the_package_is_not_computed_on_import():
    code = (
        "import pointray as pr; pr.render\nfrom pointray.shade.lobe_tables import LOBES; print('real' in vars(LOBES))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
