"""The engine room: the vector type against NumPy, the disk cache, and who imports what."""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pointray
from pointray import simd
from pointray.jit import inline, kernel, run, take

PACKAGE = Path(pointray.__file__).parent
RNG = np.random.default_rng(11)

# --------------------------------------------------------------------------------------------------- the vector type


@kernel
def _sixteen(work, a, b, out, words):  # type: ignore[no-untyped-def]
    """One row of `out` for each operation on two vectors of 16 lanes, one word for each comparison."""
    x, y = simd.load16(a, 0), simd.load16(b, 0)
    simd.store(out, 0, x + y)
    simd.store(out, 16, x - y)
    simd.store(out, 32, x * y)
    simd.store(out, 48, x / y)
    simd.store(out, 64, simd.vmin(x, y))
    simd.store(out, 80, simd.vmax(x, y))
    simd.store(out, 96, simd.vabs(x))
    simd.store(out, 112, simd.select(x < y, x, y))
    simd.store(out, 128, x * a[3] + b[5])
    simd.store(out, 144, simd.quarters(a[0], a[1], a[2], a[3]))
    simd.store(out, 160, simd.repeat4(a, 5))
    simd.store(out, 176, simd.sum_quarters(x))
    simd.store(out, 192, simd.shift_quarter(x, y))
    simd.store(out, 208, simd.spread16(a[7]))
    words[0], words[1] = simd.bits(x < y), simd.bits(x <= y)
    words[2], words[3] = simd.bits(x > y), simd.bits(x >= y)
    words[4], words[5] = simd.bits((x < y) & (x > a[0])), simd.bits((x < y) | (x > a[0]))
    words[6], words[7] = simd.bits((x < y) ^ (x > a[0])), simd.lowest(simd.bits(x >= x))
    return 0


@kernel
def _eight(work, a, b, out, words):  # type: ignore[no-untyped-def]
    """The same with 8 lanes, from an odd place."""
    x, y = simd.load8(a, 3), simd.load8(b, 1)
    simd.store(out, 0, x * y - simd.spread8(a[0]))
    simd.store(out, 8, simd.vmin(x, y))
    simd.store(out, 16, simd.vmax(x, y))
    words[0] = simd.bits(x <= y)
    for k in range(8):
        words[1 + k] = simd.reinterpret_int(simd.lane(x, k))
    return 0


@kernel
def _packed(work, a, source, target, words):  # type: ignore[no-untyped-def]
    """Append the chosen of 32 numbers, in two steps."""
    n = simd.pack(simd.load16(a, 0) > np.float32(0), source, 0, target, 0)
    words[0] = n
    words[1] = n + simd.pack(simd.load16(a, 16) > np.float32(0), source, 16, target, n)
    return 0


def word(truth):
    return int(np.packbits(truth, bitorder="little").astype(np.int64) @ (256 ** np.arange(len(truth) // 8)))


def pair(n=32):
    a, b = RNG.normal(size=(2, n)).astype(np.float32)
    b[4] = a[4]  # so that < and <= differ
    return a, b


def test_sixteen_lanes_do_as_numpy_does():
    a, b = pair()
    out, words = np.zeros(14 * 16, np.float32), np.zeros(8, np.int64)
    run(_sixteen, 1, a, b, out, words, threads=1)
    x, y = a[:16], b[:16]
    quarters = [a[lane // 4] for lane in range(16)]
    sums = np.repeat(x.reshape(4, 4).sum(axis=1), 4)
    want = [x + y, x - y, x * y, x / y, np.minimum(x, y), np.maximum(x, y), np.abs(x), np.where(x < y, x, y)]
    want += [x * a[3] + b[5], quarters, np.tile(a[5:9], 4), sums, np.concatenate([x[12:], y[:12]]), np.full(16, a[7])]
    for row, (got, expected) in enumerate(zip(out.reshape(14, 16), want, strict=True)):
        assert got == pytest.approx(expected, rel=1e-6, abs=1e-6), f"row {row}"
    first = x > a[0]
    truths = [x < y, x <= y, x > y, x >= y, (x < y) & first, (x < y) | first, (x < y) ^ first]
    assert words.tolist() == [*map(word, truths), 0]


def test_nan_and_inf_lanes():
    """A comparison with NaN is false, and where one is NaN min and max give the second."""
    a, b = pair()
    a[0], b[1], a[2], b[3] = np.nan, np.nan, np.inf, -np.inf
    out, words = np.zeros(14 * 16, np.float32), np.zeros(8, np.int64)
    run(_sixteen, 1, a, b, out, words, threads=1)
    least, greatest = out.reshape(14, 16)[4:6]
    assert least[0] == greatest[0] == b[0] and np.isnan(least[1]) and np.isnan(greatest[1])
    assert least[2:4].tolist() == [b[2], -np.inf] and greatest[2:4].tolist() == [np.inf, a[3]]
    assert np.isinf(out[2 * 16 + 2]) and np.isinf(out[2 * 16 + 3])
    with np.errstate(invalid="ignore"):
        assert words[:4].tolist() == [word(t) for t in (a < b, a <= b, a > b, a >= b) for t in [t[:16]]]
    assert words[7] == 1  # NaN is not even >= itself


def test_eight_lanes_do_as_numpy_does():
    a, b = pair()
    out, words = np.zeros(24, np.float32), np.zeros(9, np.int64)
    run(_eight, 1, a, b, out, words, threads=1)
    x, y = a[3:11], b[1:9]
    assert out == pytest.approx(np.concatenate([x * y - a[0], np.minimum(x, y), np.maximum(x, y)]), rel=1e-6, abs=1e-6)
    assert words[0] == word(x <= y)
    assert words[1:].tolist() == x.view(np.int32).tolist()


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_packing(share):
    a = np.where(RNG.random(32) < share, 1, -1).astype(np.float32)
    source, target, words = np.arange(100, 132, dtype=np.int32), np.full(64, -1, np.int32), np.zeros(2, np.int64)
    run(_packed, 1, a, source, target, words, threads=1)
    chosen = source[a > 0]
    assert words.tolist() == [(a[:16] > 0).sum(), len(chosen)]
    assert target[: len(chosen)].tolist() == chosen.tolist()


# --------------------------------------------------------------------------------------------------- the thread loop


@inline
def _mark(counts, tile):  # type: ignore[no-untyped-def]
    counts[tile] += 1


@kernel
def _marks(work, counts):  # type: ignore[no-untyped-def]
    """Count each tile that is taken."""
    mine, tile = 0, take(work)
    while tile >= 0:
        _mark(counts, tile)
        mine += 1
        tile = take(work)
    return mine


@pytest.mark.parametrize("threads", [1, 2, 7])
@pytest.mark.parametrize("tiles", [0, 1, 5, 20_000])
def test_every_tile_is_taken_once(tiles, threads):
    counts = np.zeros(max(tiles, 1), np.int64)
    taken = run(_marks, tiles, counts, threads=threads)
    assert sum(taken) == tiles and len(taken) == min(threads, max(tiles, 1))
    assert (counts[:tiles] == 1).all()


def test_what_a_kernel_raises_comes_out():
    with pytest.raises(TypeError):
        run(_marks, 3, threads=2)


# --------------------------------------------------------------------------------------------------- the disk cache

PROGRAM = """
import numpy as np
from pointray import jit, simd
from pointray.vec import dot

@jit.inline
def weighted(a):
    return dot((a[0], a[1], a[2]), (1.0, 10.0, 100.0))

@jit.kernel
def product(work, a, out):
    out[0] = weighted(a)
    return 0

@jit.kernel
def beyond(work, a, at, out):
    simd.store(out, 0, simd.load8(a, at))
    return 0

out = np.zeros(8)
jit.run(product, 1, np.array([1.0, 2.0, 3.0]), out)
print(int(out[0]), jit.compilations())
if jit.CHECK:
    try:
        jit.run(beyond, 1, np.zeros(16, np.float32), 9, np.zeros(8, np.float32))
    except IndexError as error:
        print("IndexError:", error)
"""


class Elsewhere:
    """A copy of the package, a program that uses it, and a cache folder of their own."""

    def __init__(self, folder):
        self.source, self.cache = folder / "source", folder / "cache"
        ignore = shutil.ignore_patterns("__pycache__")
        shutil.copytree(PACKAGE, self.source / "pointray", ignore=ignore)
        self.program = folder / "program.py"
        self.program.write_text(PROGRAM)

    def start(self, **environment):
        keep = {k: v for k, v in os.environ.items() if not k.startswith("POINTRAY")}
        keep |= {"PYTHONPATH": str(self.source), "POINTRAY_CACHE": str(self.cache)} | environment
        command = [sys.executable, "-W", "error", str(self.program)]
        return subprocess.Popen(command, env=keep, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def run(self, **environment):
        """What the program printed: the product, and how many kernels were compiled."""
        return self.finish(self.start(**environment))

    @staticmethod
    def finish(process):
        out, err = process.communicate(timeout=120)
        assert process.returncode == 0 and err == "", err
        return out.split("\n")[:-1]


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory):
    place = Elsewhere(tmp_path_factory.mktemp("elsewhere"))
    # Two at once on an empty cache: neither disturbs the other.
    printed = [place.finish(p) for p in [place.start(), place.start()]]
    assert ["321 1"] in printed and all(lines in (["321 1"], ["321 0"]) for lines in printed)
    return place


def test_a_second_process_compiles_nothing(elsewhere):
    assert elsewhere.run() == ["321 0"]


@pytest.mark.parametrize("suffix", [".nbc", ".nbi"])
def test_a_damaged_cache_is_compiled_again(elsewhere, tmp_path, suffix):
    shutil.copytree(elsewhere.cache, tmp_path / "cache")
    files = list((tmp_path / "cache").rglob("*" + suffix))
    assert files
    for file in files:
        file.write_bytes(file.read_bytes()[:100] + b"damaged")
    for compiled in (1, 0):
        assert elsewhere.run(POINTRAY_CACHE=str(tmp_path / "cache")) == [f"321 {compiled}"]


@pytest.mark.parametrize("where", ["below a file", "a file"])
def test_a_cache_that_cannot_be_written_is_no_error(elsewhere, tmp_path, where):
    file = tmp_path / "file"
    file.write_text("in the way")
    assert elsewhere.run(POINTRAY_CACHE=str(file / "cache" if where == "below a file" else file)) == ["321 1"]
    assert file.read_text() == "in the way"


def test_the_check_switch_sees_a_load_beyond_an_array(elsewhere):
    lines = elsewhere.run(POINTRAY_CHECK="1")
    assert lines == ["321 1", "IndexError: a vector reaches beyond its array"]


def test_an_edit_of_another_file_of_the_package_is_seen(elsewhere):
    vec = elsewhere.source / "pointray" / "vec.py"
    text = vec.read_text()
    old = "return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]"
    assert text.count(old) == 1
    try:
        vec.write_text(text.replace(old, old + " + 1000.0"))
        assert elsewhere.run() == ["1321 1"]
    finally:
        vec.write_text(text)
    assert elsewhere.run() == ["321 0"]


def test_an_edit_of_a_piece_beside_the_kernel_is_seen(elsewhere):
    """Outside of the package too, where the sources' hash does not reach: the twins in tests/ are such kernels."""
    try:
        elsewhere.program.write_text(PROGRAM.replace("(1.0, 10.0, 100.0)", "(2.0, 20.0, 200.0)"))
        assert elsewhere.run() == ["642 1"]
    finally:
        elsewhere.program.write_text(PROGRAM)


# --------------------------------------------------------------------------------------------------- who imports what

# From above to below: design.md, section 2. A stage imports only what stands above it.
STAGES = ["jit", "simd", "vec", "records", "data", "neighbors", "camera", "points", "splats", "tree", "trace"]
STAGES += ["shade", "image", "model", "scene", "render", "view", "report", "demonstration", "cli"]
ENGINE = {"numba", "llvmlite"}


def modules():
    return [p for p in sorted(PACKAGE.rglob("*.py")) if p != PACKAGE / "__init__.py"]


def stage_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports(path):
    """Names of the modules that a file imports: 'pointray.x.y' for those of the package."""
    names = []
    package = ["pointray", *path.relative_to(PACKAGE).parts[:-1]]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level:
            base = ".".join([*package[: len(package) + 1 - node.level], *filter(None, [node.module])])
            names += [base] if base != "pointray" else [f"pointray.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names.append(str(node.module))
    return names


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_a_stage_imports_only_what_stands_above_it(path):
    assert stage_of(path) in STAGES, "a new stage: say in this list where it stands"
    own = STAGES.index(stage_of(path))
    inner = [n.split(".")[1] for n in imports(path) if n.startswith("pointray.")]
    below = [n for n in inner if n in STAGES and STAGES.index(n) > own]
    assert not below, f"imports {below}, which stand below it"


def test_only_the_engine_room_imports_numba():
    using = {stage_of(p) for p in modules() if ENGINE & {n.split(".")[0] for n in imports(p)}}
    assert using == {"jit", "simd"}
