"""Files in stores of fsspec, here in memory: reading, errors, and packages that are missing."""

import errno
import sys
import tempfile

import numpy as np
import pytest

import pointray as pr
from helpers.copc_files import write_copc
from pointray.io.remote.errors import store_error
from pointray.io.remote.remote_file import RemoteFile, location_of

fsspec = pytest.importorskip("fsspec")


@pytest.fixture
def store(tmp_path, monkeypatch):
    """A file system in memory; temporary copies are in an empty folder, which must be empty in the end."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    files = fsspec.filesystem("memory")
    files.mkdir("/scans")
    yield files
    files.rm("/scans", recursive=True)
    assert list((tmp_path / "temporary").iterdir()) == []


def test_a_file_is_read_like_a_local_one(store, tmp_path):
    pr.write(tmp_path / "a.ply", pr.procedural("sphere", 1000))
    store.pipe("/scans/a.ply", (tmp_path / "a.ply").read_bytes())
    seen = []
    points = pr.read("memory://scans/a.ply", progress=lambda *state: seen.append(state))
    assert np.array_equal(points.positions, pr.read(tmp_path / "a.ply").positions)
    assert ("downloading a.ply", 1.0) in seen


def test_copc_is_read_in_pieces(store, tmp_path, rng, monkeypatch):
    copc = write_copc(tmp_path / "a.copc.laz", rng.random((2000, 3)) * 1023, 3, rng)
    store.pipe("/scans/a.copc.laz", copc.path.read_bytes())
    monkeypatch.setattr(RemoteFile, "copy", None)  # not called
    points = pr.read("memory://scans/a.copc.laz", resolution=16)
    assert np.array_equal(points.world, pr.read(copc.path, resolution=16).world)
    assert 0 < len(points) < 200


@pytest.mark.parametrize("more", [b"1 1 1\n", b""], ids=["another size", "the same size"])
def test_a_file_replaced_during_the_download_is_an_error(store, more):
    store.pipe("/scans/a.xyz", b"0 0 0\n1 0 0\n0 1 0\n")
    file = location_of("memory://scans/a.xyz")
    assert file.facts.tag
    store.pipe("/scans/a.xyz", b"0 0 0\n1 0 0\n0 1 0\n" + more)
    with pytest.raises(OSError, match="was modified while it was read"):
        file.copy()


@pytest.mark.parametrize("announced", [False, True])
def test_a_file_replaced_while_its_pieces_are_read_is_an_error(store, announced):
    store.pipe("/scans/a.bin", bytes(10_000))
    file = location_of("memory://scans/a.bin")
    reader = file.pieces.open()
    if announced:
        reader.announce([(5000, 5010)])
    reader.seek(5000)
    assert reader.read(10) == bytes(10)
    store.pipe("/scans/a.bin", b"x" * 10_000)
    with pytest.raises(OSError, match="was modified while it was read"):
        reader.close()
    assert reader.closed
    reader.close()
    with file.pieces.open() as reader:  # nothing new is fetched
        assert reader.read(10) == bytes(10)
    with pytest.raises(KeyboardInterrupt), file.pieces.open() as reader:  # no further requests
        reader.seek(6000)
        reader.read(10)
        raise KeyboardInterrupt


@pytest.mark.parametrize(
    "url, kind, message",
    [
        ("memory://scans/b.ply", FileNotFoundError, "not found"),
        ("memory://scans", IsADirectoryError, "is a folder"),
        ("memory://scans/empty.ply", ValueError, "is empty"),
        ("unknown://scans/a.ply", ValueError, "unsupported kind of address"),
    ],
)
def test_errors_name_the_url(store, url, kind, message):
    store.pipe("/scans/empty.ply", b"")
    with pytest.raises(kind, match=message) as caught:
        pr.read(url)
    assert url in str(caught.value)


class EndpointConnectionError(Exception):
    """An error of a package of a store, which is not derived from OSError."""


class NoCredentialsError(Exception):
    """As above."""


class ReadTimeoutError(Exception):
    """As above."""


@pytest.mark.parametrize(
    "error, kind, message",
    [
        (EndpointConnectionError("https://me:secret@host"), ConnectionError, "cannot connect"),
        (NoCredentialsError("no secret"), PermissionError, "FSSPEC_S3="),
        (ReadTimeoutError("secret"), TimeoutError, "no answer"),
        (PermissionError("Forbidden"), PermissionError, "access denied"),
        (OSError(errno.EIO, "bad disk"), OSError, "bad disk"),
        (OSError(errno.EIO, "bad: https://me:secret@host/a?secret"), OSError, r"bad: https://host/a\?\.\.\."),
        (OSError(errno.EIO, "bad s3://key:secret@bucket/a.laz"), OSError, "bad s3://bucket/a.laz"),
        (KeyError("s3://me:sec/secret@bucket/a"), OSError, r"KeyError: 's3://\.\.\."),
        (KeyError("at https://me:secret@host/a?X-Signature=secret"), OSError, r"KeyError: 'at https://host/a\?\.\.\."),
        (ImportError("Install s3fs"), ImportError, r"pip install 'pointray\[remote\]'"),
    ],
)
def test_errors_of_packages_name_no_secrets(error, kind, message):
    url, shown = "s3://key:secret@bucket/a.laz", "s3://bucket/a.laz"
    found = store_error(error, url, shown)
    with pytest.raises(kind, match=message) as caught:
        raise found
    assert shown in str(caught.value) and "secret" not in str(caught.value)


def test_packages_that_are_no_extras_are_named_by_fsspec():
    found = store_error(ImportError("Install adlfs to access Azure"), "abfs://me:secret@a/b.laz", "abfs://a/b.laz")
    assert str(found) == "abfs://a/b.laz needs further packages: Install adlfs to access Azure"
    assert isinstance(found, ImportError)


@pytest.mark.parametrize("url", ["https://host/a.laz", "s3://bucket/a.laz", "memory://a.laz"])
def test_a_missing_package_is_an_error_with_the_command_that_installs_it(url, monkeypatch):
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(ImportError, match=r"pip install 'pointray\[remote\]'") as caught:
        pr.read(url)
    assert url in str(caught.value)
