"""Progress goes from 0 to 1 and never back."""

import numpy as np
import pytest

import pointray as pr
from helpers.clouds import sphere_points
from pointray.base.progress import part_of, report_progress
from pointray.cli.report import describe


class StageShares:
    """Records the reported shares of stages in order."""

    def __init__(self):
        self.stages, self.shares = [], []

    def __call__(self, stage, share):
        if stage not in self.stages:
            self.stages.append(stage)
            self.shares.append([])
        assert stage == self.stages[-1], f"{stage} comes back"
        self.shares[-1].append(share)

    def of(self, stage):
        return self.shares[self.stages.index(stage)]


def moves(shares, steps, longest):
    """Return whether shares go from 0 to 1 in at least this many steps, none longer than the longest allowed."""
    assert all(0 <= share <= 1 for share in shares)
    gaps = np.diff([0.0, *shares, 1.0])
    return (gaps >= 0).all() and np.count_nonzero(gaps) >= steps and gaps.max() <= longest


@pytest.mark.long
def test_a_model_reports_normals_radii_and_tree():
    points = pr.procedural("statue", 300_000)
    told = StageShares()
    pr.Model(pr.Points(points.positions), progress=told)
    assert told.stages == ["normals", "scattered points", "radii", "tree"]
    assert moves(told.of("normals"), 5, 0.5)
    assert moves(told.of("radii"), 8, 0.2)


@pytest.mark.long
def test_normals_report_progress():
    points = pr.procedural("torus", 300_000)
    for viewpoint in (None, (0, 0, 9)):
        told = StageShares()
        pr.estimate_normals(pr.Points(points.positions), viewpoint=viewpoint, progress=told)
        assert told.stages == ["normals"] and moves(told.of("normals"), 4, 0.5)


@pytest.mark.parametrize("form", ["binary", "ascii"])
def test_reading_reports_progress(tmp_path, form):
    path = tmp_path / "a.ply"
    points = pr.Points(sphere_points(600_000 if form == "binary" else 60_000))
    if form == "binary":
        pr.write(path, points)
    else:
        rows = "\n".join(f"{x:.6f} {y:.6f} {z:.6f}" for x, y, z in points.positions)
        header = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n"
        path.write_text(header + "property float x\nproperty float y\nproperty float z\nend_header\n" + rows + "\n")
    shares = []
    read = pr.read(path, progress=lambda _, share: shares.append(share))
    assert moves(shares, 3, 0.8)
    np.testing.assert_allclose(read.positions, pr.read(path).positions)


def test_progress_of_a_part_is_scaled():
    shares = []
    part = part_of(part_of(shares.append, 0.5, 1.0), 0.0, 0.5)
    for share in (0.0, 0.5, 1.0):
        report_progress(part, share)
    assert shares == [0.5, 0.625, 0.75]
    assert part_of(None, 0.0, 1.0) is None
    report_progress(None, 0.5)


def test_diagnosis_reports_progress():
    points = pr.Points(sphere_points(100_000), sphere_points(100_000))
    shares, facts = [], []
    pr.find_flaws(points, progress=lambda _, share: shares.append(share))
    assert moves(shares, 3, 0.6)
    describe(points, deep=True, progress=facts.append)
    assert moves(facts, 4, 0.5)
