"""The viewer's baked light is rough first, then fine; it follows the lights and never belongs to another scene."""

import gc
import threading
import time
import weakref

import pytest

import pointray as pr
from pointray.viewer.baker import ROUGH, Baker
from pointray.viewer.light_control import light_controls_of
from pointray.viewer.painter import FrameRequest, Painter
from pointray.viewer.view_settings import ViewSettings


class Listener:
    """Counts what a baker reports."""

    def __init__(self):
        self.ready, self.stages = 0, []
        self._changed = threading.Condition()

    def receive(self):
        with self._changed:
            self.ready += 1
            self._changed.notify_all()

    def say(self, stage, share, seconds):
        self.stages.append((stage, share))

    def wait(self, count):
        with self._changed:
            assert self._changed.wait_for(lambda: self.ready >= count, 120)


@pytest.fixture
def uncollected():
    """Python's garbage collector is off: objects are freed only if they are in no reference cycle."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def wait_until_ended(worker):
    """Wait for the threads of a painter or a baker that is closed."""
    end = time.monotonic() + 120
    while not worker.has_ended:
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.fixture
def scene():
    return ball()


def ball():
    """A sphere under a sky."""
    scene = pr.Scene()
    scene.add(pr.Model(pr.procedural("sphere", 1_000)), material=pr.Diffuse(0.5))
    scene.add_light(pr.EnvironmentLight())
    return scene


def test_light_is_rough_then_fine_then_follows_the_lights(scene):
    heard = Listener()
    baker = Baker(heard.receive, heard.say)
    assert baker.light_for(scene) is None
    heard.wait(2)
    fine = baker.light_for(scene)
    assert fine._settings.patches is None
    other = scene.copy()
    other.lights = [pr.EnvironmentLight(2.0)]
    assert baker.light_for(other) is None, "the light of other lamps must not be shown"
    heard.wait(4)
    light = baker.light_for(other)
    assert light._settings == fine._settings
    assert light.irradiance(0) == pytest.approx(2.0 * fine.irradiance(0), rel=1e-4)
    assert fine.stale is None, "what pictures may still be drawn with has changed"
    baker.close()


@pytest.mark.long
def test_another_model_is_baked_again(scene):
    heard = Listener()
    baker = Baker(heard.receive, heard.say)
    baker.light_for(scene)
    heard.wait(2)
    other = scene.copy()
    number = other.add(pr.Model(pr.procedural("torus", 1_000)), material=pr.Diffuse(0.5))
    assert baker.light_for(other) is None
    heard.wait(4)
    assert baker.light_for(other).irradiance(number).shape == (1_000, 3)
    assert ("baking light", 1.0) in heard.stages
    baker.close()


def test_a_closed_baker_stops_baking(scene):
    heard = Listener()
    baker = Baker(heard.receive, heard.say)
    baker.close()
    assert baker.light_for(scene) is None
    assert baker._thread is None and heard.ready == 0


def test_pictures_have_direct_light_until_light_is_baked(scene):
    frames, heard = [], Listener()

    def deliver(frame):
        frames.append((frame, painter.apply(frame.request).baked))
        painter.seen(frame.number)
        heard.receive()

    painter = Painter(deliver, pytest.fail, heard.say)
    camera = pr.frame(scene, size=(32, 32))
    view = ViewSettings(integrator="baked", samples=1, lamps=light_controls_of(scene, (0.0, 0.0, 1.0)))
    painter.want(FrameRequest(camera, view, scene, (1, 0), (0.0, 0.0, 1.0), True, 0.0))
    heard.wait(1)
    while frames[-1][1] is None or frames[-1][1]._settings.patches == ROUGH[0]:
        heard.wait(len(frames) + 1)
    assert frames[0][1] is None
    assert frames[-1][0].size == (32, 32), "a picture with better light must not be coarser"
    painter.close()


def test_a_closed_painter_releases_the_light(uncollected):
    heard, fine, there, scene = Listener(), [], threading.Event(), ball()

    def deliver(frame):
        light = painter.apply(frame.request).baked
        if light is not None and light._settings.patches != ROUGH[0]:
            fine.append(weakref.ref(light))
            there.set()
        painter.seen(frame.number)

    painter = Painter(deliver, pytest.fail, heard.say)
    camera = pr.frame(scene, size=(32, 32))
    view = ViewSettings(integrator="baked", samples=1, lamps=light_controls_of(scene, (0.0, 0.0, 1.0)))
    painter.want(FrameRequest(camera, view, scene, (1, 0), (0.0, 0.0, 1.0), True, 0.0))
    assert there.wait(120) and fine[0]() is not None
    painter.close()
    wait_until_ended(painter)
    assert fine[0]() is None


def test_a_stopped_bake_releases_the_scene(uncollected):
    scene, told = ball(), threading.Event()

    def say(stage, share, seconds):
        told.set()
        baker.close()

    baker = Baker(lambda: None, say)
    kept = weakref.ref(scene.models[0])
    baker.light_for(scene)
    assert told.wait(120)
    del scene
    wait_until_ended(baker)
    assert kept() is None
