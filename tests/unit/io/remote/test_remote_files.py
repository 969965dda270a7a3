"""Files on a web server: what is fetched, and what happens if the server or the connection fails."""

import gzip
import os
import tempfile
import threading
from pathlib import Path

import numpy as np
import pytest

import pointray as pr
from helpers.copc_files import write_copc
from helpers.file_server import file_server, no_proxies  # noqa: F401
from helpers.viewer_client import SECONDS
from pointray.io.files import headers, open_files, request_of
from pointray.io.previews import preview_resolution
from pointray.io.remote import remote_file, transport
from pointray.io.remote.remote_file import RemoteFile, location_of

pytest.importorskip("fsspec")
pytest.importorskip("aiohttp")
pytestmark = pytest.mark.usefixtures("no_proxies")
LEVELS, SPACING = 4, 16.0


@pytest.fixture
def server(tmp_path, monkeypatch):
    """A web server; temporary copies are in an empty folder, which must be empty in the end."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    with file_server() as server:
        yield server
        assert list(folder.iterdir()) == []


@pytest.fixture(scope="module")
def copc(tmp_path_factory):
    rng = np.random.default_rng(5)
    xyz = np.column_stack([rng.random((6000, 2)) * 1023, 300 + 100 * rng.random(6000)])
    return write_copc(tmp_path_factory.mktemp("copc") / "a.copc.laz", xyz, LEVELS, rng, SPACING)


@pytest.fixture(scope="module")
def ply(tmp_path_factory):
    path = tmp_path_factory.mktemp("ply") / "a.ply"
    pr.write(path, pr.procedural("sphere", 1000))
    return path


def assert_equal(points, other):
    assert len(points) == len(other)
    assert np.array_equal(points.world, other.world)
    assert points.attributes.keys() == other.attributes.keys()
    assert all(np.array_equal(points.attributes[name], other.attributes[name]) for name in points.attributes)


@pytest.mark.parametrize("fault", ["", "plain", "untagged", "gzip", "to /other.ply"])
def test_a_file_is_read_like_a_local_one(server, ply, fault):
    server.add("other.ply", ply.read_bytes())
    url = server.add("a.ply", ply.read_bytes(), fault)
    seen = []
    points = pr.read(url, progress=lambda stage, share: seen.append((stage, share)))
    assert_equal(points, pr.read(ply))
    assert list(dict.fromkeys(stage for stage, _ in seen)) == ["downloading a.ply", "reading"]
    shares = [share for stage, share in seen if stage == "downloading a.ply"]
    assert shares == sorted(shares) and shares[0] == 0 and (fault == "gzip" or shares[-1] == 1)


def test_local_and_remote_files_are_one_cloud(server, ply, copc):
    pr.write(other := ply.with_name("b.ply"), pr.procedural("torus", 500))
    urls = [server.add("a.ply", ply.read_bytes()), str(ply), server.add("b.ply", other.read_bytes())]
    assert_equal(pr.read(urls), pr.read([ply, ply, other]))


def test_compressed_files_are_decompressed(server, ply):
    url = server.add("a.ply.gz", gzip.compress(ply.read_bytes()))
    assert_equal(pr.read(url), pr.read(ply))
    with pytest.raises(ValueError, match=r"^http://.*/b\.ply\.gz: is damaged or cut off"):
        pr.read(server.add("b.ply.gz", gzip.compress(ply.read_bytes())[:-400]), strict=True)


def test_the_name_of_a_redirect_gives_the_format(server, tmp_path):
    (tmp_path / "a.xyz").write_text("0 0 0\n1 0 0\n0 1 0\n")
    server.add("a.xyz", (tmp_path / "a.xyz").read_bytes())
    assert len(pr.read(server.add("download", b"", "to /a.xyz"))) == 3


# -------------------------------------------------------------------------------------------------------- COPC


@pytest.mark.parametrize(
    "reading, levels",
    [
        ({"resolution": 16}, 1),
        ({"resolution": 5}, 3),
        ({"bounds": [100, 100, 0, 400, 300, 1000]}, LEVELS),
        ({"bounds": [100, 100, 0, 400, 300, 1000], "resolution": 4}, 3),
        ({"bounds": [0, 0, 0, 1024, 1024, 1024]}, LEVELS),
    ],
)
def test_only_the_needed_chunks_of_copc_are_fetched(server, copc, reading, levels):
    url = server.add("a.copc.laz", copc.path.read_bytes())
    assert_equal(pr.read(url, **reading), pr.read(copc.path, **reading))
    low, high = np.reshape(reading.get("bounds", [0, 0, 0, 1024, 1024, 1024]), (2, 3))
    needed = 0
    for (level, *cell), (_, size) in copc.chunks.items():
        corner = np.array(cell) * 1024 / 2**level
        if level < levels and (corner <= high).all() and (corner + 1024 / 2**level >= low).all():
            needed += size
    listing = sum(size for _, size in copc.pages)
    assert needed < server.bytes <= 1.3 * needed + transport.HEAD + 60 + listing
    assert max(size for _, size in server.sent) < copc.path.stat().st_size


def test_neighbouring_chunks_are_fetched_in_few_requests(server, copc):
    url = server.add("a.copc.laz", copc.path.read_bytes())
    pr.read(url, bounds=[0, 0, 0, 1024, 1024, 1024])
    assert len(server.sent) < 10 < len(copc.chunks)


def test_distant_chunks_are_fetched_several_at_once(server, copc):
    file = RemoteFile(server.add("a.copc.laz", copc.path.read_bytes()))
    assert file.pieces is not None
    server.faults["a.copc.laz"] = "together"
    spans = [(k * 10_000, k * 10_000 + 100) for k in range(6)]
    with file.pieces.open() as reader:
        reader.announce(spans)
        for start, stop in spans:
            reader.seek(start)
            assert reader.read(100) == copc.path.read_bytes()[start:stop]
    assert server.most_at_once > 1


def test_all_of_a_copc_file_is_downloaded_at_once(server, copc):
    url = server.add("a.copc.laz", copc.path.read_bytes())
    assert_equal(pr.read(url), pr.read(copc.path))
    assert server.bytes == transport.HEAD + copc.path.stat().st_size


def test_without_ranges_the_whole_copc_file_is_downloaded_with_a_warning(server, copc):
    url = server.add("a.copc.laz", copc.path.read_bytes(), "plain")
    with pytest.warns(UserWarning, match=rf"^{url}: the server cannot send parts of files"):
        points = pr.read(url, resolution=5)
    assert_equal(points, pr.read(copc.path, resolution=5))


def test_headers_of_copc_need_no_download(server, copc):
    url = server.add("a.copc.laz", copc.path.read_bytes())
    file = location_of(url)
    for _ in range(3):  # the second time, nothing is fetched
        [(named, format, listing)] = headers(file, request_of(resolution=16))
        assert named is file and format.name == "LAS" and listing.facts["COPC spacing"] == SPACING
    assert server.bytes == transport.HEAD + 60 + copc.pages[0][1]


def test_a_lost_connection_is_tried_again(server, copc):
    url = server.add("a.copc.laz", copc.path.read_bytes(), "lose one")
    assert_equal(pr.read(url, resolution=5), pr.read(copc.path, resolution=5))


def test_damaged_chunks_are_reported_like_those_of_local_files(server, copc, tmp_path):
    data = bytearray(copc.path.read_bytes())
    start, _ = copc.chunks[0, 0, 0, 0]
    data[start + 30 : start + 34] = b"\xff" * 4
    (tmp_path / "b.copc.laz").write_bytes(data)
    url = server.add("b.copc.laz", bytes(data))
    messages = []
    for path in (tmp_path / "b.copc.laz", url):
        with pytest.raises(ValueError, match="is damaged") as caught:
            pr.read(path, resolution=16)
        messages.append(str(caught.value).removeprefix(f"{path}: "))
    assert messages[0] == messages[1]


@pytest.mark.parametrize("most, rows", [(50, 1), (300, 1), (1000, 2), (2000, 3), (6000, None), (10_000, None)])
def test_the_resolution_of_a_preview_fits_the_number_of_points(server, copc, most, rows):
    file = location_of(server.add("a.copc.laz", copc.path.read_bytes()))
    found = preview_resolution([file], request_of(), most)
    assert found == (None if rows is None else SPACING / 2 ** (rows - 1))
    if rows is not None and rows > 1:
        assert len(pr.read(copc.path, resolution=found)) <= most < len(pr.read(copc.path, resolution=found / 2))


def test_previews_are_for_remote_copc_files_only(server, copc, ply):
    urls = server.add("a.copc.laz", copc.path.read_bytes()), server.add("a.ply", ply.read_bytes())
    plain = server.add("b.copc.laz", copc.path.read_bytes(), "plain")
    for path in (copc.path, urls[1], plain):
        assert preview_resolution([location_of(path)], request_of(), 1000) is None
    assert preview_resolution([location_of(url) for url in urls], request_of(), 1000) is None
    assert preview_resolution([location_of(urls[0])], request_of(resolution=16), 1000) is None
    assert preview_resolution([location_of(urls[0])] * 2, request_of(), 500) == SPACING


# ------------------------------------------------------------------------------------------------------- faults

FAULTS = {
    "404": (FileNotFoundError, "not found (HTTP 404)"),
    "410": (FileNotFoundError, "not found (HTTP 410)"),
    "403": (PermissionError, "access denied (HTTP 403)"),
    "401": (PermissionError, "access denied (HTTP 401)"),
    "429": (OSError, "refuses further requests for now (HTTP 429)"),
    "500": (OSError, "reports an error (HTTP 500)"),
    "418": (OSError, "unexpected answer of the server (HTTP 418)"),
    "html": (OSError, "is a web page, not a scan"),
    "loop": (OSError, "more than 10 redirects"),
    "cut": (ConnectionError, "connection lost"),
    "cut later": (ConnectionError, "connection lost"),
    "stall": (TimeoutError, "no answer from the server within 0.3 seconds"),
    "silent": (TimeoutError, "no answer from the server within 0.3 seconds"),
    "changing": (OSError, "was modified while it was read"),
    "to http://127.0.0.1:1/a": (ConnectionError, "cannot connect to the server"),
    "to file:///etc/passwd": (ValueError, "or a redirect to one"),
    "to http://a..b/a": (ValueError, "or a redirect to one"),
    "to ftp://127.0.0.1/a": (ValueError, "or a redirect to one"),
}


@pytest.mark.parametrize("in_pieces", [False, True], ids=["whole", "pieces"])
@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_errors_that_name_the_url(server, copc, ply, fault, in_pieces, monkeypatch):
    kind, message = FAULTS[fault]
    if kind is TimeoutError:
        monkeypatch.setattr(transport, "READ", 0.3)
    data = (copc.path if in_pieces else ply).read_bytes()
    url = server.add("a.copc.laz" if in_pieces else "a.ply", data, fault)
    secret = url.replace("http://", "http://me:secret@") + "?signature=secret"
    with pytest.raises(kind) as caught:
        pr.read(secret, **({"resolution": 5} if in_pieces else {}))
    text = str(caught.value)
    assert message in text and f"{url}?..." in text and "\n" not in text and "secret" not in text
    assert caught.value.__cause__ is None or "secret" not in str(caught.value.__cause__)
    if isinstance(caught.value, OSError):
        assert caught.value.filename == f"{url}?..." and caught.value.errno


@pytest.mark.parametrize("fault", ["longer", "cut"])
def test_a_body_shorter_than_announced_is_an_error(server, ply, fault):
    with pytest.raises(ConnectionError, match="connection lost before all bytes were received"):
        pr.read(server.add("a.ply", ply.read_bytes(), fault))


def test_a_length_that_contradicts_the_ranges_is_an_error(server, ply):
    with pytest.raises(OSError, match="was modified while it was read"):
        pr.read(server.add("a.ply", ply.read_bytes(), "shorter"))


def test_empty_files_are_errors(server):
    for fault in ("", "plain"):
        with pytest.raises(ValueError, match=r"^http://127\.0\.0\.1:\d+/a\.ply: is empty"):
            pr.read(server.add("a.ply", b"", fault))


def test_servers_that_cannot_be_reached_are_errors():
    for url in ("http://127.0.0.1:1/a.ply", "http://nothing.invalid/a.ply"):
        with pytest.raises(ConnectionError, match="cannot connect to the server") as caught:
            pr.read(url)
        assert caught.value.filename == url


def test_the_time_to_connect_is_limited(server, ply, monkeypatch):
    monkeypatch.setattr(transport, "CONNECT", 1e-9)
    with pytest.raises(TimeoutError, match="no answer from the server within 1e-09 seconds"):
        pr.read(server.add("a.ply", ply.read_bytes()))


def test_files_that_are_no_scans_are_refused_without_a_download(server):
    url = server.add("a.doc", b"some text that is not a scan" * 10)
    with pytest.raises(ValueError, match=rf"^{url}: unsupported file type \.doc"):
        pr.read(url)
    url = server.add("a.ply", b"some text that is not a scan" * 10)
    with pytest.raises(ValueError, match=rf"^{url}: invalid PLY file"):
        pr.read(url)
    url = server.add("a.zip", b"PK" * 10_000)
    with pytest.raises(ValueError, match=rf"^{url}: unsupported file type \.zip: unpack it"):
        pr.read(url)
    assert max(size for _, size in server.sent) == transport.HEAD


def test_a_file_that_refers_to_others_does_not_fetch_them(server, tmp_path):
    """A glTF file in the net that names a buffer in the net."""
    server.add("secret.bin", bytes(1000))
    text = '{"asset":{"version":"2.0"},"buffers":[{"byteLength":36,"uri":"URL"}],"bufferViews":[{"buffer":0,'
    text += '"byteLength":36}],"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}],'
    text += '"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"nodes":[{"mesh":0}],"scenes":[{"nodes":[0]}]}'
    with pytest.raises((ValueError, OSError)):
        pr.read(server.add("a.gltf", text.replace("URL", server.url("secret.bin")).encode()))
    assert "secret.bin" not in {path for path, _ in server.sent}


def test_a_full_disk_is_an_error(server, ply, monkeypatch):
    url = server.add("a.ply", ply.read_bytes())
    monkeypatch.setattr(remote_file, "SPARE", 1 << 62)
    with pytest.raises(OSError, match="too little space for it in .*: free some, or set TMPDIR") as caught:
        pr.read(url)
    assert caught.value.filename == url


def test_copies_are_removed_when_reading_fails(server, ply, tmp_path):
    url, folder = server.add("a.ply", ply.read_bytes()), Path(tempfile.gettempdir())
    seen = []

    def progress(stage, share):
        seen.append(len(list(folder.iterdir())))
        if stage == "reading":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pr.read(url, progress=progress)
    assert seen[-1] == 1 and list(folder.iterdir()) == []


@pytest.mark.parametrize("fault", ["", "stall whole"])
@pytest.mark.parametrize("kind", [KeyboardInterrupt, SystemExit, RuntimeError])
def test_exceptions_of_the_progress_callback_stop_a_download(server, ply, kind, fault):
    url, caught = server.add("a.ply", ply.read_bytes(), fault), []

    def progress(stage, share):
        if stage == "downloading a.ply" and share > 0:
            raise kind

    def read():
        try:
            pr.read(url, progress=progress)
        except BaseException as error:
            caught.append(type(error))

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    thread.join(SECONDS)
    assert caught == [kind]
    server.faults["a.ply"] = ""
    assert len(pr.read(url)) == 1000  # the thread of fsspec is alive


def test_a_copy_lasts_until_it_is_released(server, ply):
    file = RemoteFile(server.add("a.ply", ply.read_bytes()))
    assert file.suffix == ".ply" and file.stem == "a"
    path = file.copy()
    assert path.name == "a.ply" and path.read_bytes() == ply.read_bytes() and file.copy() == path
    assert len(pr.read(file)) == 1000 and path.exists()
    file.release()
    assert not path.parent.exists()
    file.release()


def test_a_released_download_stops(server, ply):
    file = RemoteFile(server.add("a.ply", ply.read_bytes()))
    with pytest.raises(OSError, match="canceled"):
        file.copy(lambda stage, share: file.release() if share else None)


def test_files_changed_by_nobody_are_read_within_one_context(server, ply):
    with open_files(server.add("a.ply", ply.read_bytes()), request_of()) as [opener], opener.open() as source:
        assert opener.name == server.url("a.ply") and source.listing.count == 1000
        assert len(os.listdir(tempfile.gettempdir())) == 1
