"""Remote files read in pieces: the requests that are sent, and the bytes that are returned."""

from concurrent.futures import Future

import pytest

from pointray.io.remote.range_reader import CONNECTIONS, LARGEST, WASTE, Kept, RangeReader, announce, joined


class Fetches:
    """A file in memory, and the spans that were fetched of it; results come when they are waited for."""

    def __init__(self, data):
        self.data, self.spans, self.open = data, [], []

    def __call__(self, start, stop):
        assert 0 <= start < stop <= len(self.data)
        self.spans.append((start, stop))
        future = Future()
        future.set_result(self.data[start:stop])
        self.open.append(future)
        return future


@pytest.fixture
def fetches(rng):
    return Fetches(rng.bytes(100_000))


def reader_of(fetches, kept=None):
    return RangeReader(fetches, len(fetches.data), kept or Kept(b""))


def test_random_reads_return_the_bytes_of_the_file(fetches, rng):
    with reader_of(fetches) as file:
        for _ in range(200):
            start, size = int(rng.integers(0, 101_000)), int(rng.integers(0, 3000))
            if rng.random() < 0.1:
                spans = [(int(x), int(x) + 500) for x in rng.integers(0, 101_000, 20)]
                announce(file, spans, keep=rng.random() < 0.5)
            assert file.seek(start) == file.tell() == start
            assert file.read(size) == fetches.data[start : start + size]
            assert file.tell() == max(start, min(start + size, len(fetches.data)))
        file.seek(-10, 2)
        assert file.read() == fetches.data[-10:]
        buffer = bytearray(20)
        file.seek(99_990)
        assert file.readinto(buffer) == 10 and buffer[:10] == fetches.data[-10:]


def test_joined_spans_are_covered_with_little_waste(rng):
    for _ in range(100):
        starts = rng.integers(0, 1 << 26, int(rng.integers(1, 200)))
        spans = [
            (int(x), int(x) + int(size)) for x, size in zip(starts, rng.integers(1, 1 << 19, len(starts)), strict=True)
        ]
        requests = joined(spans)
        assert requests == sorted(requests)
        assert all(end <= start for (_, end), (start, _) in zip(requests, requests[1:], strict=False))
        assert all(any(a <= start and stop <= b for a, b in requests) for start, stop in spans)
        needed, end = 0, 0
        for start, stop in sorted(spans):
            needed, end = needed + max(stop - max(start, end), 0), max(end, stop)
        assert sum(b - a for a, b in requests) <= (1 + WASTE) * needed


def test_neighbours_share_a_request_up_to_a_size():
    assert joined([(0, 100), (100, 200), (210, 300)]) == [(0, 300)]
    assert joined([(0, 100), (200, 300)]) == [(0, 100), (200, 300)]
    assert joined([]) == []
    half = LARGEST // 2
    assert joined([(k * half, (k + 1) * half) for k in range(4)]) == [(0, 2 * half), (2 * half, 4 * half)]
    assert joined([(0, 3 * LARGEST)]) == [(0, 3 * LARGEST)]


def test_announced_spans_are_fetched_ahead_once(fetches):
    spans = [(k * 1000, k * 1000 + 100) for k in range(50)]
    with reader_of(fetches) as file:
        announce(file, spans)
        assert len(fetches.spans) == CONNECTIONS
        for k, (start, stop) in enumerate(spans):
            file.seek(start)
            assert file.read(60) + file.read(40) == fetches.data[start:stop]
            assert len(fetches.spans) == min(k + CONNECTIONS, 50)
    assert fetches.spans == spans


def test_kept_spans_are_fetched_once_for_all_readers(fetches):
    kept, spans = Kept(fetches.data[:50]), [(2000, 2100), (2100, 2300), (50_000, 50_500)]
    for _ in range(2):
        with reader_of(fetches, kept) as file:
            announce(file, spans, keep=True)
            for start, stop in [*spans, (0, 50), (7, 9), (300, 320)]:
                file.seek(start)
                assert file.read(stop - start) == fetches.data[start:stop]
    assert fetches.spans == [(2000, 2300), (50_000, 50_500), (300, 320)]


def test_spans_outside_of_the_file_are_ignored(fetches):
    with reader_of(fetches) as file:
        announce(file, [(-5, 10), (99_999, 100_001), (7, 7), (9, 3), (2**63, 2**64)])
        announce(file, [(-5, 10), (99_999, 100_001)], keep=True)
    assert fetches.spans == []


def test_requests_are_cancelled_when_a_file_is_closed():
    waiting = []

    def fetch(start, stop):
        waiting.append(Future())
        return waiting[-1]

    file = RangeReader(fetch, 1000, Kept(b""))
    file.announce([(0, 10), (500, 510)])
    file.close()
    file.close()
    assert len(waiting) == 2 and all(future.cancelled() for future in waiting)


def test_local_files_need_no_announcement(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"abc")
    with path.open("rb") as file:
        announce(file, [(0, 2)])
        assert file.read() == b"abc"
