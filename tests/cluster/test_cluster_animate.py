"""`animate` yields the pictures of `render`, in this process or on workers."""

import time
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest

import pointray as pr
from helpers.dask_clusters import ball, camera_of, cluster_of, scene_of
from helpers.marks import long
from pointray.baking import baked
from pointray.cluster.dispatch import aligned
from pointray.rendering import picture, sequence

CAMERAS = [camera_of(36, 24, turn) for turn in np.linspace(0, 6, 7)]


@pytest.fixture(scope="module")
def workers() -> Iterator[Any]:
    with cluster_of(2, processes=False) as client:
        yield client


@pytest.fixture(params=["here", "there"])
def client(request: pytest.FixtureRequest, workers: Any) -> Any:
    """No client, and one with workers."""
    return workers if request.param == "there" else None


@cache
def model() -> pr.Model:
    return ball(1000)


def new_scene() -> pr.Scene:
    """Return a new scene of the shared model."""
    return scene_of(model())


def assert_same(images: list[Any], scene: pr.Scene, settings: pr.Settings) -> None:
    assert len(images) == len(CAMERAS)
    for camera, image in zip(CAMERAS, images, strict=True):
        np.testing.assert_array_equal(image, pr.render(scene, camera, settings))


@pytest.mark.parametrize(
    "settings", [pr.Settings(spp=2), long(pr.Settings("ao", spp=2, denoise=True))], ids=["", "denoised"]
)
def test_each_picture_equals_that_of_render(client: Any, settings: pr.Settings) -> None:
    scene, told = new_scene(), list[float]()
    assert_same(
        list(pr.animate(scene, CAMERAS, settings, lambda _, share: told.append(share), client)), scene, settings
    )
    assert 0 <= told[0] <= told[-1] <= 1 and told[-1] > 0.5
    assert told == sorted(told) or settings.denoise
    assert client is not None or {round(7 * share) for share in told} >= set(range(1, 8))


def test_the_scene_and_the_cameras_are_those_of_the_call(client: Any) -> None:
    scene, cameras = new_scene(), list(CAMERAS)
    before, images = scene.copy(), pr.animate(scene, cameras, client=client)
    first = next(images)
    scene.update(0, pr.transform(scale=0.5))
    del cameras[:]
    assert_same([first, *images], before, pr.Settings())
    assert (pr.render(scene, CAMERAS[0]) != first).any()


def test_pictures_are_rendered_on_demand(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Any] = []
    real = sequence.render_snapshot
    monkeypatch.setattr(sequence, "render_snapshot", lambda *args: made.append(args[1]) or real(*args))
    images = pr.animate(new_scene(), CAMERAS)
    assert made == []
    next(images)
    assert made == CAMERAS[:1]


def test_no_cameras_make_no_pictures(client: Any) -> None:
    assert list(pr.animate(new_scene(), [], client=client)) == []


def test_an_error_in_progress_ends_the_film(client: Any) -> None:
    def stop(stage: str, share: float) -> None:
        raise InterruptedError

    settings = pr.Settings("path", spp=20_000, max_depth=2)
    with pytest.raises(InterruptedError):
        list(pr.animate(new_scene(), CAMERAS, settings, stop, client))


def test_an_abandoned_film_cancels_its_jobs(workers: Any) -> None:
    images = pr.animate(new_scene(), CAMERAS, pr.Settings("path", spp=40, max_depth=2), client=workers)
    next(images)
    images.close()  # type: ignore[attr-defined]  # as leaving a loop does
    end = time.monotonic() + 120
    while any(workers.processing().values()):
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"scene": 1}, "scene must be a Scene"),
        ({"cameras": CAMERAS[0]}, "cameras must be a sequence of Camera"),
        ({"cameras": [CAMERAS[0], None]}, r"cameras\[1\] must be a Camera"),
        ({"settings": "path"}, "settings must be Settings, or None"),
        ({"progress": 1}, "progress must be callable"),
        ({"client": "tcp://a:1"}, "client must be a dask"),
    ],
)
def test_wrong_arguments_are_refused_at_the_call(wrong: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        pr.animate(**{"scene": new_scene(), "cameras": CAMERAS, **wrong})


def test_pictures_that_do_not_fit_are_refused_at_the_call(monkeypatch: pytest.MonkeyPatch) -> None:
    def check(size: int, why: str) -> None:
        if size > 1 << 20:
            raise ValueError(why)

    monkeypatch.setattr(picture, "check_memory", check)
    pr.animate(new_scene(), CAMERAS)
    with pytest.raises(ValueError, match="for a picture of 5000x4000"):
        pr.animate(new_scene(), [*CAMERAS, camera_of(5000, 4000)])


def public_state(scene: pr.Scene) -> dict[str, Any]:
    """Return the values of all public properties of a scene."""
    names = [name for name, value in vars(pr.Scene).items() if isinstance(value, property)]
    return {name: getattr(scene, name) for name in [*names, "shows_sky"]}


@pytest.mark.parametrize("call", ["render", "animate", "render_layers"])
def test_light_baked_for_a_call_is_not_kept(call: str, monkeypatch: pytest.MonkeyPatch) -> None:
    bakes: list[Any] = []
    real, few = baked.bake, pr.BakeSettings(patches=64, links=4)
    monkeypatch.setattr(baked, "bake", lambda *args: bakes.append(args) or real(args[0], few))
    scene, settings = new_scene(), pr.Settings("baked")
    scene.lights = [pr.EnvironmentLight(1.0)]
    before = public_state(scene)
    with pytest.warns(UserWarning, match=r"no baked light.*set scene\.baked = pr\.bake\(scene\)") as caught:
        if call == "animate":
            images = pr.animate(scene, CAMERAS[:2], settings)
            assert len(list(images)) == 2
        else:
            getattr(pr, call)(scene, CAMERAS[0], settings)
    assert [one.filename for one in caught] == [__file__]
    assert len(bakes) == 1 and scene.baked is None
    after = public_state(scene)
    assert before.keys() == after.keys()
    for name, value in before.items():
        np.testing.assert_equal(after[name], value)


def test_received_arrays_are_aligned() -> None:
    """Kernels refuse others: a film by workers over a contact shadow failed, depending on the layout of the message."""
    message = memoryview(bytearray(41))[1:]
    image = np.frombuffer(message, np.float32)
    assert not image.flags.aligned
    (once,), same = aligned(((image,), 3.0))
    assert once.flags.aligned and same == 3.0
    np.testing.assert_array_equal(once, image)
