"""Up directions: sixty clouds of all kinds, file formats, depth camera frames, and the printed reasons."""

from functools import partial

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from helpers import upright_clouds as made
from helpers.places import MODELS
from helpers.upright_parts import unit_rows
from pointray.auto_view.camera_frame import find_camera_frame
from pointray.auto_view.evidence import AXES
from pointray.auto_view.first_view import Scan, ViewChoice
from pointray.auto_view.sample import sample_of
from pointray.auto_view.upright import FORMATS, REASONS, WEIGHTS, axis_direction, find_up, weighted_evidence

UP = {
    "points/stanford_bunny.ply": "y",
    "points/stanford_dragon.ply": "y",
    "points/stanford_bunny_rangescans.ply": "y",
    "points/stanford_dragon_stand_rangescans.ply": "y",
    "points/stanford_lucy_50k.ply": "y",
    "points/nefertiti_50k.ply": "z",
    "points/potree_lion_takanawa_rgb.ply": "z",
    "points/outcrop_qcompass_rgb.ply": "z",
    "points/autzen_stadium_crop_rgb.ply": "z",
    "points/rgbd_kinect_chair_rgb.ply": "-y",
    "points/tls_pumpA_rgb.ply": "z",
    "points/sfm_garden_rgb_nonormals.ply": "z",
    "points/tls_tower_wall_ghost_nonormals.ply": "z",
    "raw/bun000_rangegrid_ascii.ply": "y",
    "raw/bun0_ascii.pcd": "y",
    "raw/bunnyFloat.e57": "y",
    "raw/kitten_xyz_normals.xyz": "y",
    "raw/small_gicp_target.ply": "z",
    "raw/treels_spruce.laz": "z",
    "raw/laspy_vegetation_1_3.las": "z",
    "raw/pcl_samp11_utm.pcd": "z",
    "raw/depth_7scenes_000300.png": "-y",
    "raw/pcl_mosd_learn0.pcd": "-y",
    "raw/3dgs_biker.compressed.ply": "-y",
    "raw/Zaghetto_binary.pcd": "-y",
    "../cases/depth_mm.png": "-y",
    "../cases/depthcam_realsense_yup_zback.ply": "y",
    "../cases/depthcam_ydown_zforward.ply": "-y",
    "../cases/pcd_organised_nan.pcd": "-y",
    "../cases/tree_z_up.ply": "z",
}
INTRINSICS = {"raw/depth_7scenes_000300.png": (585, 585, 320, 240), "../cases/depth_mm.png": (140, 140, 80, 60)}
# A cloud, its up axis, and whether it has normals.
MADE = [
    (made.tree, "z", False),
    (made.tree, "-y", False),
    (made.tree, "x", True),
    (partial(made.tree, floor=True), "-z", False),
    (partial(made.tree, cone=True), "y", False),
    (partial(made.tree, cone=True, floor=True), "-x", True),
    (made.forest, "z", False),
    (made.forest, "-y", False),
    (made.head, "z", True),
    (made.head, "y", False),
    (made.bare_head, "z", False),
    (made.bare_head, "x", False),
    (made.person, "z", False),
    (made.person, "-y", True),
    (made.animal, "y", False),
    (made.chair, "z", False),
    (made.chair, "-x", False),
    (made.table, "y", False),
    (made.lamp, "z", False),
    (made.car, "z", True),
    (made.car, "y", False),
    (made.house, "z", False),
    (made.house, "-z", True),
    (made.room, "z", False),
    (made.room, "y", False),
    (partial(made.room, ceiling=False), "-y", False),
    (partial(made.room, seen=True), "z", True),
    (made.street, "z", False),
    (made.street, "-z", False),
    (made.terrain, "z", False),
    (made.terrain, "y", True),
    (made.vase, "z", True),
    (made.sweep, "z", False),
    (made.sweep, "-y", False),
]


def up_of(points):
    return find_up(sample_of(points)).axis


def points_of(cloud, with_normals=True):
    return pr.Points(cloud.positions, cloud.normals if with_normals else None)


def shared_clouds():
    for name, up in UP.items():
        if (MODELS / name).exists():
            yield name, pr.read(MODELS / name, intrinsics=INTRINSICS.get(name)), up


def made_clouds(seed=1000):
    for k, (make, up, with_normals) in enumerate(MADE):
        rng = np.random.default_rng([seed, k])
        yield f"{make} {up}", points_of(made.turned(make(rng), up, rng), with_normals), up


@pytest.mark.scans
@pytest.mark.slow
def test_sixty_clouds_stand_upright():
    wrong = [name for clouds in (shared_clouds(), made_clouds()) for name, points, up in clouds if up_of(points) != up]
    assert len(UP) + len(MADE) >= 60 and len(wrong) <= 2, wrong


@pytest.mark.parametrize("sign", [1, 0, -1])
@pytest.mark.parametrize("make", [made.room, made.street])
@pytest.mark.parametrize(("up", "turn"), [("-y", (1, 1, 1)), ("y", (1, -1, -1))])
def test_a_frame_of_a_camera_is_seen_from_it_and_upright(make, up, turn, sign, rng):
    """This holds for normals of either sign, or none."""
    frame = made.frame(rng, make)
    points = pr.Points(frame.positions * turn, frame.normals * turn * sign if sign else None)
    scan = Scan(points, ViewChoice())
    assert scan.up == axis_direction(up) and "frame of a depth camera" in scan.found
    camera = scan.camera()
    ahead = np.subtract(camera.target, camera.eye)
    assert ahead @ (0, 0, turn[2]) / np.linalg.norm(ahead) > 0.9


def test_a_thinned_frame_is_a_frame_and_what_is_seen_from_all_sides_is_none(rng):
    frame = made.frame(rng)
    some = frame.positions[rng.random(len(frame.positions)) < 0.4]
    assert find_camera_frame(frame.positions).certainty == 1
    assert find_camera_frame(some).up == "-y" and find_camera_frame(some).certainty < 1
    for make in (made.head, made.chair, made.person):
        body = made.turned(make(rng), "-y", rng).positions
        body = (body - body.mean(axis=0)) / np.ptp(body, axis=0).max()
        assert find_camera_frame(body + (0, 0, 1.5)) is None
    assert find_camera_frame(frame.positions + (0, 0, -3)) is None
    rays = np.column_stack([rng.uniform(-0.6, 0.6, 4000), rng.uniform(-0.45, 0.45, 4000), np.ones(4000)])
    assert find_camera_frame(rays) is not None and find_camera_frame(rays * rng.choice((1, 2), (4000, 1))) is None


@pytest.mark.parametrize("format", FORMATS)
def test_a_format_decides_where_nothing_else_does(format, rng):
    georeference = pr.Georeference(format=format)
    found = find_up(sample_of(pr.Points(unit_rows(rng.normal(size=(3000, 3))), georeference=georeference)))
    assert found.axis == FORMATS[format][0]
    if found.axis != "z":
        assert found.why == f"{format} files are {'y down' if found.axis == '-y' else 'y up'}"


def test_readers_name_their_formats(tmp_path, rng):
    """The format is kept by selections and models; a rotated instance has none."""
    rows = rng.random((50, 3)) * 9
    pr.write(tmp_path / "a.las", pr.Points(rows))
    np.savetxt(tmp_path / "a.pts", rows, fmt="%.3f", header="50", comments="")
    np.savetxt(tmp_path / "a.xyz", rows, fmt="%.3f")
    Image.fromarray(np.full((20, 20), 1000, np.uint16)).save(tmp_path / "a.png")
    intrinsics = {"a.png": (20, 20, 10, 10)}
    found = {
        name: pr.read(tmp_path / name, intrinsics=intrinsics.get(name)) for name in ("a.las", "a.pts", "a.xyz", "a.png")
    }
    assert [points.georeference.format for points in found.values()] == ["LAS", "PTS", None, "depth image"]
    assert pr.read([tmp_path / "a.las", tmp_path / "a.las"]).georeference.format == "LAS"
    assert pr.read([tmp_path / "a.pts", tmp_path / "a.xyz"]).georeference.format is None
    model = pr.Model(found["a.las"].select(np.arange(40)))
    assert sample_of(model).format == "LAS"
    for angle, format in ((0, "LAS"), (90, None)):
        scene = pr.Scene()
        scene.add(model, pr.transform((1, 2, 3), angle, (1, 0, 0)))
        assert sample_of(scene).format == format


def test_stations_stand_beside_each_other(rng):
    stations = tuple(map(tuple, [(0.0, 0.0, 5.0), (0.0, 3.0, 5.1), (0.0, 6.0, 4.9)]))
    ball = unit_rows(rng.normal(size=(2000, 3))) + (0, 3, 5)
    sample = sample_of(pr.Points(ball, georeference=pr.Georeference(stations=stations)))
    np.testing.assert_allclose(sample.stations + sample.origin, stations)
    scores = dict(zip(AXES, weighted_evidence(sample)["stations"], strict=True))
    assert scores["y"] == scores["-y"] < -0.4 and scores["z"] > -0.05


def test_what_is_wide_stands_on_what_is_thin(rng):
    shape = partial(trunk_scores, rng)
    assert shape(made.tree, "y") > 0.3 and shape(made.lamp, "y") > 0.3
    assert abs(shape(made.vase, "y")) < 0.2 and abs(shape(made.head, "y")) < 0.2


def trunk_scores(rng, make, up):
    points = made.turned(make(rng), up, rng)
    return weighted_evidence(sample_of(points_of(points)))["trunk"][AXES.index(up)]


def test_far_points_do_not_matter(rng):
    clean = made.head(rng).positions
    dirty = np.concatenate([clean, [[1e6, 0, 0]], rng.normal(size=(5, 3)) + 300])
    assert find_up(sample_of(pr.Points(dirty))) == find_up(sample_of(pr.Points(clean)))


def test_few_points_and_points_in_one_place_have_an_up_direction():
    for rows in (np.zeros((1, 3)), np.zeros((40, 3)), np.eye(3), np.outer(np.arange(60.0), (1, 2, 3))):
        assert up_of(pr.Points(rows)) in AXES


def test_fitted_normals_of_a_model_are_used(rng):
    model = pr.Model(points_of(made.house(rng), False))
    assert weighted_evidence(sample_of(model))["normals"].any()
    assert not weighted_evidence(sample_of(model.points.with_normals(None)))["normals"].any()


def test_every_source_has_a_reason(rng):
    names = set(weighted_evidence(sample_of(points_of(made.room(rng)))))
    assert names - {"habit"} <= set(WEIGHTS) and set(WEIGHTS) | {"habit", "splats"} == set(REASONS)


def test_the_reason_is_printed(rng):
    assert (
        "up +x (stands on a trunk or post)"
        in Scan(points_of(made.turned(made.tree(rng), "x", rng)), ViewChoice()).found
    )
    las = made.turned(made.vase(rng), "y", rng)
    scan = Scan(pr.Points(las.positions, georeference=pr.Georeference(format="LAS")), ViewChoice())
    assert "up +z (LAS files are z up)" in scan.found
