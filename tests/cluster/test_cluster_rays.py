"""Rays in Dask arrays give the same hits as in NumPy arrays, to the last bit, with any scheduler."""

import pickle
from collections.abc import Iterator
from itertools import chain, product, repeat
from pathlib import Path
from typing import Any

import dask
import dask.array as da
import numpy as np
import pytest

import pointray as pr
from helpers.dask_clusters import ball, camera_of, cluster_of, scene_of
from pointray.cluster import dask_casting, serialized_scene as stowed, worker
from pointray.cluster.scattered_objects import scattered_objects_of
from pointray.scene import paged_rays as reached

MODEL = ball()
FIELDS = ("t", "position", "normal", "color", "point", "instance")


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    with cluster_of(2, processes=False) as client:
        yield client


def rays(rows: int = 8, columns: int = 7) -> tuple[Any, Any]:
    """Return rays of a picture: (rows, columns, 3) each."""
    return camera_of(columns, rows).rays(slice(0, rows))


def arrays_of(hits: pr.Hits) -> dict[str, Any]:
    """Return fields and attributes by name."""
    return {name: getattr(hits, name) for name in FIELDS} | {f"attribute {k}": v for k, v in hits.attributes.items()}


def assert_same(found: pr.Hits, wanted: pr.Hits) -> None:
    """Check all arrays of hits, computed together."""
    assert_equal(arrays_of(found), arrays_of(wanted))


def assert_equal(found: Any, wanted: Any) -> None:
    """Check shape, dtype and bits of an array, or of each of several, before and after they are computed."""
    found, wanted = (each if isinstance(each, dict) else {"": each} for each in (found, wanted))
    assert list(found) == list(wanted)
    for name, array in found.items():
        assert isinstance(array, da.Array)
        assert (array.shape, array.dtype) == (wanted[name].shape, wanted[name].dtype), name
    (values,) = dask.compute(found, scheduler="threads")  # workers in this process leave clients
    for name, array in values.items():
        assert (array.shape, array.dtype) == (wanted[name].shape, wanted[name].dtype), name
        np.testing.assert_array_equal(array, wanted[name], name)


@pytest.mark.parametrize("rows", [1, 3, 8, (2, 6), (0, 8, 0)])
def test_hits_are_the_same_for_every_chunk_size(rows: Any) -> None:
    scene, (origins, directions) = scene_of(MODEL), rays()
    wanted, dark = scene.intersect(origins, directions, attributes="height"), scene.occluded(origins, directions)
    assert 0 < np.isfinite(wanted.t).sum() < wanted.t.size
    for columns, last in product([1, 3, 7], [1, 3]):
        chunks = rows, columns, last
        given = da.from_array(origins, chunks=chunks), da.from_array(directions, chunks=chunks)
        found = scene.intersect(*given, attributes="height")
        assert found.t.chunks == given[0].chunks[:2]
        assert found.position.chunks == (*given[0].chunks[:2], (3,))
        blocked = scene.occluded(*given)
        assert blocked.chunks == found.t.chunks
        assert_equal(arrays_of(found) | {"occluded": blocked}, arrays_of(wanted) | {"occluded": dark})


def test_each_array_can_be_computed_alone() -> None:
    scene, given = scene_of(MODEL), rays()
    found = scene.intersect(*(da.from_array(each, chunks=(3, 7, 3)) for each in given), attributes="height")
    wanted = arrays_of(scene.intersect(*given, attributes="height"))
    for name, array in arrays_of(found).items():
        assert_equal(array, wanted[name])


def test_rays_and_limits_are_broadcast() -> None:
    scene, (_, directions) = scene_of(MODEL), rays()
    eye = np.array(camera_of().eye)
    hits = scene.intersect(eye, directions)
    far = np.where(np.arange(7) % 2, 100.0, 4.0).astype(np.float32)
    near = np.linspace(0.0, 5.0, 8)[:, None]
    for t_min, t_max in ((0, np.inf), (near, far), (0.5, far), (near, 3)):
        wanted = scene.intersect(eye, directions, t_min, t_max)
        some = [
            (eye, da.from_array(directions, chunks=(3, 4, 2)), t_min, t_max),
            (da.from_array(eye, chunks=1), directions, t_min, da.asarray(t_max)),
            (da.from_array(eye[None, None], chunks=1), da.from_array(directions, chunks=(3, 7, 3)), t_min, t_max),
            (eye, directions, t_min, da.from_array(np.broadcast_to(t_max, 7), chunks=4)),
            (eye, directions, da.from_array(np.broadcast_to(t_min, (8, 1)), chunks=(3, 1)), t_max),
        ]
        for given in some:
            found = arrays_of(scene.intersect(*given)) | {"occluded": scene.occluded(*given)}
            assert_equal(found, arrays_of(wanted) | {"occluded": np.isfinite(wanted.t)})
    assert (hits.t != wanted.t).any()


def test_one_ray_and_no_rays() -> None:
    scene = scene_of(MODEL)
    for shape in ((3,), (0, 3), (4, 0, 3)):
        given = np.zeros(shape) + (0.0, -4.0, 0.0), np.zeros(shape) + (0.0, 1.0, 0.0)
        lazy = [da.from_array(each, chunks=2) for each in given]
        assert_same(scene.intersect(*lazy), scene.intersect(*given))
        assert_equal(scene.occluded(*lazy), scene.occluded(*given))


def test_attributes_have_their_dtypes_and_columns() -> None:
    rows = MODEL.points.positions
    some = {
        "class": np.arange(len(rows), dtype=np.uint8) % 3,
        "time": rows[:, 0].astype(np.float64),
        "color pair": rows[:, :2].astype(np.float32),
        "t": rows[:, 2] > 0,
    }
    scene = pr.Scene()
    scene.add(pr.Model(pr.Points(rows, rows, attributes=some)))
    origins, directions = rays()
    lazy = [da.from_array(each, chunks=(3, 7, 3)) for each in (origins, directions)]
    names = list(some)
    assert_same(scene.intersect(*lazy, attributes=names), scene.intersect(origins, directions, attributes=names))


def count_calls(monkeypatch: pytest.MonkeyPatch, of: Any, name: str) -> list[Any]:
    """Record calls of a function of a module."""
    calls: list[Any] = []
    function = getattr(of, name)
    monkeypatch.setattr(of, name, lambda *args, **rest: calls.append(args) or function(*args, **rest))
    return calls


def test_rays_are_traced_lazily_and_once(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, given = scene_of(MODEL), rays()
    traced = count_calls(monkeypatch, reached, "closest_hits")
    hits = scene.intersect(*(da.from_array(each, chunks=(2, 7, 3)) for each in given), attributes="height")
    assert traced == []
    (found,) = dask.compute(hits)
    assert isinstance(found, pr.Hits) and len(traced) == 4
    monkeypatch.undo()
    wanted = scene.intersect(*given, attributes="height")
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))
    np.testing.assert_array_equal(found.attributes["height"], wanted.attributes["height"])


def test_the_scene_is_that_of_the_call() -> None:
    scene, given = scene_of(MODEL), rays()
    wanted = scene.intersect(*given)
    lazy = scene.intersect(*(da.from_array(each, chunks=(2, 7, 3)) for each in given))
    scene.update(0, pr.transform(translate=(0, 0, 0.3)))
    scene.clips = [((0, 0, 0), (0, 0, 1))]
    assert (scene.intersect(*given).t != wanted.t).any()
    assert_same(lazy, wanted)


def test_results_of_one_call_can_be_passed_to_the_next() -> None:
    scene, given = scene_of(MODEL), rays()
    lazy = [da.from_array(each, chunks=(2, 7, 3)) for each in given]

    def in_shade(hits: pr.Hits) -> Any:
        return scene.occluded(hits.position + hits.normal * np.float32(0.01), (-1.0, -1.0, 2.0))

    found, wanted = in_shade(scene.intersect(*lazy)), in_shade(scene.intersect(*given))
    assert_equal(found, wanted)
    assert 0 < wanted.sum() < wanted.size


@pytest.mark.parametrize("scheduler", ["threads", "sync"])
def test_any_scheduler_of_dask_computes_them(scheduler: str) -> None:
    scene, given = scene_of(MODEL), rays()
    lazy = scene.intersect(*(da.from_array(each, chunks=(3, 2, 3)) for each in given))
    np.testing.assert_array_equal(lazy.t.compute(scheduler=scheduler), scene.intersect(*given).t)


def test_workers_compute_the_same_and_get_the_model_once(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    model = ball(1100)
    scene, given = scene_of(model), rays()
    sent = count_calls(monkeypatch, client, "scatter")
    with client.as_current():
        for k in range(3):
            scene.update(0, pr.transform(translate=(0, 0, 0.1 * k)))
            lazy = scene.intersect(*(da.from_array(each, chunks=(2, 7, 3)) for each in given), attributes="height")
            (found,) = dask.compute(lazy)
            wanted = scene.intersect(*given, attributes="height")
            np.testing.assert_array_equal(found.t, wanted.t)
            np.testing.assert_array_equal(found.attributes["height"], wanted.attributes["height"])
        assert len(sent) == 1
        np.testing.assert_array_equal(lazy.t.compute(scheduler="threads"), wanted.t)
        assert [name for name in client.who_has() if str(name).startswith("model of 1100")]
    # A client that is no longer the default has all that is needed.
    np.testing.assert_array_equal(lazy.t.compute(scheduler="sync"), wanted.t)


def test_models_in_otherwise_equal_scenes_are_not_confused(client: Any) -> None:
    given = rays()
    chunked = [da.from_array(each, chunks=(4, 7, 3)) for each in given]
    scenes = [scene_of(ball(n)) for n in (1000, 1001)]
    for lazy, wanted in [(scene.intersect(*chunked).t, scene.intersect(*given).t) for scene in scenes]:
        np.testing.assert_array_equal(client.compute(lazy).result(), wanted)


def test_the_graph_contains_little_data_of_a_scene(client: Any) -> None:
    model = ball(20_000)
    with client.as_current():
        held = stowed.SerializedScene(scene_of(model))
        assert len(pickle.dumps(held)) < 20_000
    assert len(pickle.dumps(held)) > 1_000_000


def test_a_client_that_is_not_the_default_computes_them(client: Any) -> None:
    scene, given = scene_of(ball(1200)), rays()
    lazy = scene.intersect(*(da.from_array(each, chunks=(4, 7, 3)) for each in given))
    np.testing.assert_array_equal(client.compute(lazy.t).result(), scene.intersect(*given).t)


def test_a_model_of_the_workers_of_another_scheduler_is_reported(client: Any) -> None:
    scene, given = scene_of(ball(1300)), rays()
    with client.as_current():
        lazy = scene.intersect(*(da.from_array(each, chunks=(4, 7, 3)) for each in given))
        with cluster_of(1, processes=False) as other, pytest.raises(ValueError, match="workers of another client"):
            other.compute(lazy.t).result()


def test_a_saved_model_is_sent_as_its_path(client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model, given = ball(1500), rays()
    model.save(tmp_path / "ball.pointray")
    scene = scene_of(model)
    wanted = scene.intersect(*given).t
    chunked = [da.from_array(each, chunks=(4, 7, 3)) for each in given]
    sent = count_calls(monkeypatch, client, "scatter")
    loaded = count_calls(monkeypatch, worker, "_load")
    with client.as_current():
        np.testing.assert_array_equal(scene.intersect(*chunked).t.compute(), wanted)
        assert (sent, len(loaded) > 0) == ([], True)
        del loaded[:]
        # Other workers do not see it.
        scattered_objects_of(client).asked.clear()
        monkeypatch.setattr(stowed, "_check_places", lambda places: [False] * len(places))
        scene.update(0, pr.transform())  # workers keep scenes
        np.testing.assert_array_equal(scene.intersect(*chunked).t.compute(), wanted)
        assert (len(sent), loaded) == (1, [])


def test_a_later_worker_that_does_not_see_a_file_is_reported(
    client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = ball(1600)
    model.save(tmp_path / "other.pointray")

    def unseen(place: Any) -> Any:
        raise worker.UnseenFileError(place)

    monkeypatch.setattr(worker, "_load", unseen)
    with client.as_current(), pytest.raises(worker.UnseenFileError, match=r"does not see .*other\.pointray"):
        scene_of(model).occluded(*(da.from_array(each, chunks=-1) for each in rays())).compute()


def test_another_version_is_refused(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    lazy = scene_of(MODEL).occluded(*(da.from_array(each, chunks=-1) for each in rays()))
    monkeypatch.setattr(stowed, "version_here", chain(["0.0.9"], repeat(pr.__version__)).__next__)
    with pytest.raises(
        ValueError, match=rf"this worker has pointray {pr.__version__}, the scene was sent by pointray 0\.0\.9"
    ):
        client.compute(lazy).result()


def unknown(array: Any) -> Any:
    return array[array[:, 0] > -100]


ROWS = da.from_array(np.ones((8, 3)), chunks=(3, 3))


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ((ROWS[:, :2], ROWS), r"origins must have the shape \(\.\.\., 3\), got \(8, 2\)"),
        ((ROWS, ROWS[:, 0]), r"directions must have the shape \(\.\.\., 3\), got \(8,\)"),
        ((ROWS[0, 0], ROWS), r"origins must have the shape"),
        ((ROWS, ROWS[:5]), r"do not broadcast: leading shapes \[\(8,\), \(5,\)"),
        ((ROWS, ROWS, ROWS[:3, 0]), "do not broadcast"),
        ((ROWS, ROWS, 0, np.ones(7)), "do not broadcast"),
        ((ROWS.astype(bool), ROWS), "origins must contain real numbers, not bool"),
        ((ROWS, ROWS.astype(complex)), "directions must contain real numbers, not complex128"),
        ((ROWS, ROWS, ROWS[:, 0].astype("U4")), "t_min must contain real numbers"),
        ((ROWS, ROWS, 0, "far"), "t_max must contain real numbers"),
        ((unknown(ROWS), ROWS), "origins has chunks of unknown size: call its compute_chunk_sizes"),
        ((ROWS, ROWS, unknown(ROWS)[:, 0]), "t_min has chunks of unknown size"),
    ],
)
def test_wrong_arrays_are_refused_before_anything_is_computed(
    given: Any, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = scene_of(MODEL)
    monkeypatch.setattr(dask_casting, "chunked_like", None)
    monkeypatch.setitem(dask.config.config, "scheduler", lambda *_, **__: pytest.fail("it was computed"))
    for cast in (scene.intersect, scene.occluded):
        with pytest.raises(ValueError, match=text):
            cast(*given)


def test_attributes_that_no_model_has_are_refused_at_the_call() -> None:
    for given in ((ROWS, ROWS), (np.ones(3), np.ones(3))):
        with pytest.raises(ValueError, match="no model has an attribute 'depth'"):
            scene_of(MODEL).intersect(*given, attributes="depth")


@pytest.mark.long
def test_other_processes_compute_the_same(tmp_path: Path) -> None:
    sent, saved, given = ball(5000), ball(3000), rays(40, 30)
    saved.save(tmp_path / "ball.pointray")
    chunked = [da.from_array(each, chunks=(10, 30, 3)) for each in given]
    with cluster_of(2, processes=True) as client, client.as_current():
        for model in (sent, saved):
            scene = scene_of(model)
            (found,) = dask.compute(scene.intersect(*chunked, attributes="height"))
            wanted = scene.intersect(*given, attributes="height")
            for name in FIELDS:
                np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))
            np.testing.assert_array_equal(found.attributes["height"], wanted.attributes["height"])
            np.testing.assert_array_equal(scene.occluded(*chunked).compute(), scene.occluded(*given))
    np.testing.assert_array_equal(scene.occluded(*chunked).compute(scheduler="processes"), scene.occluded(*given))
