"""A thread collects only its own warnings; other threads and warning filters are not affected."""

import threading
import warnings

import pytest

from pointray.base.warning_log import collect_warnings, warn


def test_warnings_are_issued_or_collected():
    with pytest.warns(UserWarning, match="given") as told:
        warn("given")
    assert told[0].filename == __file__
    with collect_warnings() as notes:
        warn("first")
        with collect_warnings() as inner:
            warn("second", FutureWarning)
        warn("third")
    assert (notes, inner) == (["first", "third"], ["second"])


def test_a_thread_that_collects_changes_nothing_for_others():
    """Overlapping `warnings.catch_warnings` of two threads would leave the filters of one in place."""
    before, inside, done = list(warnings.filters), threading.Event(), threading.Event()

    def collect():
        with collect_warnings() as notes:
            warn("of the thread")
            inside.set()
            done.wait()
            warn("of the thread, later")
        assert len(notes) == 2

    thread = threading.Thread(target=collect)
    thread.start()
    inside.wait()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(UserWarning, match="here"):
            warn("here")
        done.set()
        thread.join()
        with pytest.raises(UserWarning, match="here"):
            warn("here")
    assert warnings.filters == before
