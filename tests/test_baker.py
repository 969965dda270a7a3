"""The viewer's baked light: rough at first, then fine; it follows the lights, and never belongs to another scene."""

import threading

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

    def hear(self):
        with self._changed:
            self.ready += 1
            self._changed.notify_all()

    def say(self, stage, share, seconds):
        self.stages.append((stage, share))

    def wait(self, count):
        with self._changed:
            assert self._changed.wait_for(lambda: self.ready >= count, 120)


@pytest.fixture
def scene():
    scene = pr.Scene()
    scene.add(pr.Model(pr.procedural("sphere", 3_000)), material=pr.Diffuse(0.5))
    scene.add_light(pr.EnvironmentLight())
    return scene


def test_light_is_rough_then_fine_then_follows_the_lights(scene):
    heard = Listener()
    baker = Baker(heard.hear, heard.say)
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


def test_another_model_is_baked_anew(scene):
    heard = Listener()
    baker = Baker(heard.hear, heard.say)
    baker.light_for(scene)
    heard.wait(2)
    other = scene.copy()
    number = other.add(pr.Model(pr.procedural("torus", 3_000)), material=pr.Diffuse(0.5))
    assert baker.light_for(other) is None
    heard.wait(4)
    assert baker.light_for(other).irradiance(number).shape == (3_000, 3)
    assert ("baking light", 1.0) in heard.stages
    baker.close()


def test_a_closed_baker_bakes_no_more(scene):
    heard = Listener()
    baker = Baker(heard.hear, heard.say)
    baker.close()
    assert baker.light_for(scene) is None
    assert baker._thread is None and heard.ready == 0


def test_pictures_have_direct_light_until_light_is_baked(scene):
    frames, heard = [], Listener()

    def deliver(frame):
        frames.append((frame, painter.apply(frame.request).baked))
        painter.seen(frame.number)
        heard.hear()

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
