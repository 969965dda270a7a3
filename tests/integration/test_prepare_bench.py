"""`bench/preparation/prepare.py`: its clock, and a run at a small size."""

import time

import numpy as np
import pytest

import pointray as pr
from bench.preparation.prepare import child, median_of, stage_table
from bench.preparation.stages import STAGES, Clock


def test_nested_stages_have_total_and_own_times():
    clock = Clock()
    with clock.stage("outer"):
        time.sleep(0.02)
        with clock.stage("inner"), clock.stage("outer"):
            time.sleep(0.05)
    outer, inner = clock.spent["outer"], clock.spent["inner"]
    assert outer.seconds >= inner.seconds + 0.02 >= 0.07
    assert outer.own == pytest.approx(outer.seconds - inner.seconds, abs=1e-9)
    assert inner.own == inner.seconds
    assert inner.peak == 0


@pytest.mark.long
@pytest.mark.parametrize("words", [(), ("--without-normals", "--noise", 0.005)])
def test_every_stage_is_found_in_the_package(tmp_path, words):
    pr.write(tmp_path / "a.ply", pr.procedural("torus", 3000))
    found = child("stages.py", tmp_path / "a.ply", *words)
    assert found["points"] == 3000
    optional = {"fits", "orientation"} if not words else set()
    assert {"read", *STAGES, "whole model", "levels"} - optional - set(found["stages"]) == set()
    whole = found["stages"]["whole model"]["seconds"]
    most = whole + found["stages"]["levels"]["seconds"]  # levels have radii and trees too
    assert 0.0 < sum(found["stages"][name]["seconds"] for name in ("normals", "radii", "tree")) <= most
    assert all(np.isfinite(list(spent.values())).all() for spent in found["stages"].values())
    assert len(stage_table("torus", [median_of([found, found])]).rows) >= 7
