"""URLs: their detection, names without secrets, and file names."""

from pathlib import Path

import pytest

import pointray as pr
from pointray.io.remote.addresses import check_url, clean_name, file_name_of, is_url, shown_url
from pointray.io.remote.remote_file import RemoteFile, location_of


@pytest.mark.parametrize(
    "value, remote",
    [
        ("https://host/a.laz", True),
        ("S3://bucket/a.laz", True),
        ("memory://a.ply", True),
        ("file:///home/a.ply", False),
        ("a.ply", False),
        ("C://a.ply", False),
        ("data/https://a", False),
        (Path("a.ply"), False),
        (None, False),
        (b"https://host/a", False),
    ],
)
def test_urls_are_detected(value, remote):
    assert is_url(value) == remote


@pytest.mark.parametrize(
    "url, shown",
    [
        ("https://host/a.laz", "https://host/a.laz"),
        ("https://me:secret@host:80/a.laz", "https://host:80/a.laz"),
        ("https://me:se@cret@host/a.laz", "https://host/a.laz"),
        ("https://host/a@b.laz", "https://host/a@b.laz"),
        ("https://me:se@c/secret@host/a.laz", "https://..."),  # or a file secret@host/a.laz
        ("https://me:123/secret@host/a.laz", "https://..."),
        ("https://me:123?secret@host/a.laz", "https://..."),
        ("https://host/a.laz?mail=me@secret", "https://host/a.laz?..."),
        ("https://host/a.laz#part?secret", "https://host/a.laz"),
        ("https://host/a.laz?X-Signature=secret&x=1", "https://host/a.laz?..."),
        ("https://host/a.laz#secret", "https://host/a.laz"),
        ("https://host?secret", "https://host?..."),
        ("s3://key:secret@bucket/a/b.laz", "s3://bucket/a/b.laz"),
    ],
)
def test_messages_show_urls_without_secrets(url, shown):
    assert shown_url(url) == shown
    file = RemoteFile(url)
    assert str(file) == shown and "secret" not in repr(file)


@pytest.mark.parametrize(
    "address, shown",
    [
        ("https://me:sec/secret@host/a.ply", "https://..."),
        ("https://me:sec?secret@host/a.ply", "https://..."),
        ("https://me:sec#secret@host/a.ply", "https://..."),
        ("https://me:sec/secret@host/a.ply?x=a@secret", "https://..."),
        ("s3://key:sec/secret@bucket/a.ply", "s3://..."),
        ("https:/me:secret@host/a.ply", "https:/host/a.ply"),
        ("HTTPS:/me:secret@host/a.ply", "HTTPS:/host/a.ply"),
        ("https:/me:sec/secret@host/a.ply", "https:/..."),
        (Path("https://me:secret@host/a.ply"), "https:/host/a.ply"),
        (Path("sftp://me:secret@host/a.ply"), "sftp:/host/a.ply"),
        (Path("https://me:sec?secret@host/a.ply"), "https:/..."),
    ],
)
def test_messages_about_broken_urls_contain_no_secrets(address, shown):
    with pytest.raises(ValueError) as caught:
        pr.read(address)
    text = str(caught.value).replace("\\", "/")  # of paths on Windows
    assert text.startswith(f"{shown}: ") and "sec" not in text


@pytest.mark.parametrize(
    "url, message",
    [
        ("http:///a.ply", "the host is missing"),
        ("http://[::1/a.ply", "invalid URL"),
        ("http://host:port/a.ply", "invalid URL"),
        ("http://me:secret@host/a b.ply", "write %20"),
        ("http://host/a\nb.ply", "control characters"),
        ("http://me:secret@a..b/a.ply", r"^http://a\.\.b/a\.ply: invalid URL"),
        (f"https://{'a' * 64}.org/a.ply", r"^https://a{64}\.org/a\.ply: invalid URL"),
        ("zip://a.ply::https://host/a.zip", "chained"),
    ],
)
def test_invalid_urls_are_refused(url, message):
    with pytest.raises(ValueError, match=message) as caught:
        pr.read(url)
    assert "secret" not in str(caught.value)


def test_an_address_of_version_6_is_valid():
    assert check_url("http://[::1]:80/a.ply") == "http://[::1]:80/a.ply"


@pytest.mark.parametrize(
    "url, name",
    [
        ("https://host/dir/a%20b.laz?x=/c.ply", "a b.laz"),
        ("https://host/..%2f..%2fetc%2fpasswd", "_.._etc_passwd"),
        ("https://host/", "download"),
        ("https://host", "download"),
        ("memory://a.ply", "download"),
        ("s3://bucket/dir/a.copc.laz", "a.copc.laz"),
        ("https://host/...", "download"),
    ],
)
def test_file_names_stay_in_their_folder(url, name):
    assert file_name_of(url) == name


def test_long_names_keep_their_extension():
    name = clean_name("x" * 500 + ".copc.laz")
    assert len(name) == 120 and name.endswith(".copc.laz")


@pytest.mark.parametrize("letter", ["é", "点", "\U0001f5ff"])
def test_long_names_of_any_script_fit_the_file_system(letter, tmp_path):
    name = file_name_of(f"https://host/{letter * 108}.copc.laz")
    assert name.endswith(f"{letter}.copc.laz") and set(name) == set(f"{letter}.copc.laz")
    assert 116 < len(name.encode()) <= 120
    (tmp_path / name).touch()


def test_names_may_contain_half_characters():
    assert clean_name("a\ud800b.laz") == "ab.laz"


def test_local_files_stay_paths(tmp_path):
    pr.write(tmp_path / "a b.ply", pr.procedural("sphere", 100))
    assert location_of("a.ply") == Path("a.ply")
    assert len(pr.read((tmp_path / "a b.ply").as_uri())) == 100  # file://


def test_a_url_as_a_path_object_is_explained():
    with pytest.raises(ValueError, match="as a str"):
        pr.read(Path("https://host/a.ply"))


def test_equal_urls_are_equal_files():
    assert RemoteFile("http://a/b") == RemoteFile("http://a/b") != RemoteFile("http://a/b?c")
    assert len({RemoteFile("http://a/b"), RemoteFile("http://a/b"), RemoteFile("http://a/c")}) == 2
    assert RemoteFile("http://a/b?x").key != RemoteFile("http://a/b?y").key
