"""The link of a widget's view: order, limits, and files in pieces."""

import threading
import time

import pytest

from helpers.viewer_client import SECONDS
from pointray.viewer.connection import MAX_WAITING
from pointray.viewer.notebook.comm_link import PIECE, WINDOW, CommLink

MIB = 1 << 20


@pytest.fixture
def posted():
    return []


@pytest.fixture
def link(posted):
    return CommLink(lambda content, buffers: posted.append((content, buffers)), "one")


def test_messages_are_sent_in_order_with_their_view(link, posted):
    link.send("{}")
    link.send(b"abc")
    assert [({**content, "bytes": 0}, buffers) for content, buffers in posted] == [
        ({"view": "one", "text": "{}", "bytes": 0}, []),
        ({"view": "one", "bytes": 0}, [b"abc"]),
    ]


def test_messages_wait_until_earlier_ones_are_acknowledged(link, posted):
    for _ in range(8):
        link.send(bytes(MIB))
    link.send("last")
    assert len(posted) == WINDOW // MIB
    link.acknowledge(posted[0][0]["bytes"])
    assert len(posted) == WINDOW // MIB + 1
    for content, _ in list(posted[1:]):
        link.acknowledge(content["bytes"])
    assert len(posted) == 9 and posted[-1][0]["text"] == "last"


def test_a_page_that_does_not_read_is_disconnected(link, posted):
    for _ in range((WINDOW + MAX_WAITING) // MIB + 1):
        link.send(bytes(MIB))
    assert not link.open and posted[-1][0]["state"] == "gone"
    count = len(posted)
    link.send("more")
    link.acknowledge(1 << 40)
    assert len(posted) == count


@pytest.mark.parametrize("count", [-(1 << 80), -1 - MIB, 0])
def test_acknowledgements_of_nothing_have_no_effect(link, posted, count):
    for _ in range(10):
        link.send(bytes(MIB))
    link.acknowledge(count)
    assert len(posted) == WINDOW // MIB


def test_acknowledgements_of_too_much_do_not_widen_the_window(link, posted):
    link.acknowledge(1 << 80)
    for _ in range(10):
        link.send(bytes(MIB))
    assert len(posted) == WINDOW // MIB


def test_a_file_is_sent_in_pieces_as_the_page_reads_them(link, posted, tmp_path):
    file = tmp_path / "film.mp4"
    contents = bytes(range(256)) * (7 * PIECE // 256) + b"end"
    file.write_bytes(contents)
    thread = threading.Thread(target=link.send_file, args=(b"header", file), daemon=True)
    thread.start()
    read = 0
    end = time.monotonic() + SECONDS
    while thread.is_alive() or read < len(posted):
        assert time.monotonic() < end, "the file was not sent"
        for content, _ in posted[read:]:
            read += 1
            link.acknowledge(content["bytes"])
        thread.join(0.001)
    assert b"".join(buffers[0] for _, buffers in posted) == b"header" + contents
    assert [content["piece"] for content, _ in posted] == ["more"] * (len(posted) - 1) + ["last"]


def test_a_file_ends_with_the_connection(link, posted, tmp_path):
    file = tmp_path / "film.mp4"
    file.write_bytes(bytes(8 * PIECE))
    thread = threading.Thread(target=link.send_file, args=(b"header", file), daemon=True)
    thread.start()
    end = time.monotonic() + SECONDS
    while len(posted) <= WINDOW // PIECE:
        assert time.monotonic() < end, "the first pieces were not sent"
        thread.join(0.001)
    thread.join(0.05)  # it waits now, almost certainly; the test holds in either case
    link.close()
    thread.join(SECONDS)
    assert not thread.is_alive()
    with pytest.raises(OSError, match="missing"):
        link.send_file(b"", tmp_path / "missing")


def test_a_failure_of_the_notebook_ends_the_link(caplog):
    def fail(content, buffers):
        raise RuntimeError("comm is closed")

    link = CommLink(fail, "one")
    link.send("{}")
    assert not link.open and "comm is closed" in caplog.text
