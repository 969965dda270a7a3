"""A few inputs of each attack (see tests/robustness/attack/); `make attack` makes all of them."""

import sys

import pytest
from attack.ledger import Ledger
from attack.parts import KNOWN, PARTS
from attack.pool import Attacker, Failure, Tally

from helpers.marks import long

SEED = 1
needs_posix = pytest.mark.skipif(sys.platform == "win32", reason="processes of POSIX")


def test_a_whole_attack_has_220_000_inputs():
    assert sum(part.count for part in PARTS.values()) == 220_000


def patient(monkeypatch, name, limit):
    """Let an input of a part take longer before it counts as a hang, as on a busy machine."""
    monkeypatch.setitem(KNOWN, name, KNOWN[name]._replace(limit=limit))


@pytest.mark.long
@needs_posix
@pytest.mark.parametrize(("name", "few"), [("ply", 12), *(long(name, part.few) for name, part in PARTS.items())])
def test_a_few_inputs_of(name, few, monkeypatch):
    patient(monkeypatch, name, 120.0)
    with Attacker(name, SEED) as attacker:
        tally = attacker.make(0, few)
    assert tally.failures == []
    assert tally.counts["accepted"] + tally.counts["refused"] == few
    if name not in ("commands", "kills"):  # the few processes of this part may all be killed before they are done
        assert tally.counts["accepted"] > 0


@pytest.mark.long
@needs_posix
def test_a_crash_a_hang_and_a_failure_differ_from_a_refusal(monkeypatch):
    patient(monkeypatch, "sample", 10.0)
    with Attacker("sample", 0) as attacker:
        tally = attacker.make(0, 8)
    assert tally.counts == {"accepted": 2, "refused": 2, "crashed": 1, "hung": 1, "failed": 2}
    found = {failure.index: (failure.kind, failure.again) for failure in tally.failures}
    assert found == {3: ("crashed", True), 4: ("hung", True), 5: ("failed", True), 6: ("failed", True)}
    assert "SIGSEGV" in tally.failures[0].what


def test_an_attack_that_was_interrupted_goes_on(tmp_path):
    first = Ledger(tmp_path, "key")
    crash = Failure(7, "crashed", "SIGSEGV", True)
    first.keep("ply", 3, (0, 10), Tally(), 1.0)
    tally = Tally(failures=[crash])
    tally.counts.update(accepted=4, refused=5, crashed=1)
    first.keep("ply", 3, (10, 20), tally, 2.0)
    with (tmp_path / "key.jsonl").open("a") as file:
        file.write('{"part": "ply", "see')
    Ledger(tmp_path, "key").keep("toml", 3, (0, 1), Tally(), 0.1)
    again = Ledger(tmp_path, "key")
    assert again.has("toml", 3, 0, 1)
    assert again.has("ply", 3, 10, 20) and not again.has("ply", 3, 10, 21) and not again.has("ply", 4, 10, 20)
    counts = again.of("ply", 3)[0].counts
    assert (counts["inputs"], counts["accepted"], counts["crashed"]) == (20, 4, 1)
    assert "PART=ply SEED=3 INPUT=7" in again.table(["ply"], 3)
    assert not Ledger(tmp_path, "other code").has("ply", 3, 0, 10)
