"""Copies of a scene, setting all its lights, and its count of changes."""

import numpy as np
import pytest

import pointray as pr


def turned(degrees, size, position):
    return pr.transform(rotate=degrees, axis=(1, 2, 3), scale=size, translate=position)


@pytest.fixture(scope="module")
def sphere() -> pr.Model:
    return pr.Model(pr.procedural("sphere", 1000))


@pytest.fixture(scope="module")
def statue() -> pr.Model:
    return pr.Model(pr.procedural("statue", 5000))


@pytest.fixture
def scene(sphere, statue) -> pr.Scene:
    out = pr.Scene()
    out.add(statue)
    out.add(sphere, turned(50, (1, -0.7, 1.3), (2.5, 0.5, 1)))
    out.add(sphere, turned(20, 0.8, (-2, 0, 1)))
    out.add(pr.Plane((0, 0, -0.1), (0, 0.1, 1)))
    return out


def state(scene, camera):
    """Pictures of a scene, and the numbers of its hits."""
    hits = scene.intersect(*camera.rays())
    return [pr.render(scene, camera, pr.Settings("phong")), hits.instance, hits.t, hits.color]


def equal(a, b):
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


CHANGES = {
    "add": lambda scene: scene.add(pr.Plane((0, 0, 0.5), (0, 0, 1))),
    "move": lambda scene: scene.update(1, turned(10, 1.1, (1, 0, 0))),
    "paint": lambda scene: scene.update(0, material=pr.Diffuse(pr.Attribute("x", "magma", (-1, 1)))),
    "repaint": lambda scene: scene.update(2, material=pr.Diffuse((0.9, 0.1, 0.1))),
    "remove": lambda scene: scene.remove(0),
    "light": lambda scene: scene.add_light(pr.PointLight((0, -5, 1), 30)),
    "lights": lambda scene: setattr(scene, "lights", ()),
    "clips": lambda scene: setattr(scene, "clips", [((0, 0, 1), (0.1, 0.1, 1))]),
    "background": lambda scene: setattr(scene, "background", 0.3),
}


@pytest.mark.parametrize("built", [False, True])
@pytest.mark.parametrize("change", CHANGES)
def test_a_copy_and_its_original_change_independently(scene, change, built):
    scene.update(2, material=pr.Diffuse(pr.Attribute("z", "viridis")))
    scene.add_light(pr.SunLight((1, 1, -1)))
    camera = pr.Camera.frame(scene.bounds, size=(40, 30))
    if built:
        scene.snapshot()
    twin = scene.copy()
    before = state(scene, camera)
    assert equal(state(twin, camera), before)
    for changed, kept in ((twin, scene), (scene, twin)):
        other = kept.copy()  # first the copy changes, then the original does
        CHANGES[change](changed)
        assert not equal(state(changed, camera), before)
        assert equal(state(other, camera), state(kept, camera))
        if changed is twin:
            assert equal(state(kept, camera), before)
    assert equal(state(scene, camera), state(twin, camera))  # both have had the same changes


def test_a_copy_counts_its_own_changes(sphere):
    scene = pr.Scene()
    numbers = [scene.add(sphere, turned(0, 1, (3 * k, 0, 0))) for k in range(9)]
    scene.remove(numbers[4])
    twin = scene.copy()
    assert [twin.add(sphere), twin.add(sphere), scene.add(sphere)] == [9, 10, 9]
    twin.update(10, turned(0, 1, (0, 9, 0)))
    with pytest.raises(ValueError, match="no instance 10"):
        scene.update(10, np.eye(4))
    assert twin._instances.shapes[0] is sphere


def test_materials_of_a_copy_are_released(sphere):
    scene = pr.Scene()
    scene.add(sphere, material=pr.Diffuse(0.25))
    twin = scene.copy()
    assert twin._instances.materials[0] is scene._instances.materials[0]
    for k in range(20):
        twin.update(0, material=pr.Diffuse(k / 20))
    assert len(twin._instances._equal_materials) == 2 and len(scene._instances._equal_materials) == 1
    twin.add(sphere, material=pr.Diffuse(0.25))
    assert twin._instances.materials[1] is scene._instances.materials[0]  # equal materials are kept once
    scene.update(0, material=pr.Diffuse(0.5))
    twin.remove(1)
    assert len(scene._instances._equal_materials) == 1


def test_ranges_of_attributes_are_those_of_each_copy(sphere):
    scene = pr.Scene()
    scene.add(sphere, material=pr.Diffuse(pr.Attribute("z")))
    shown = scene.shown_attributes
    twin = scene.copy()
    assert twin.shown_attributes == shown
    twin.update(0, turned(0, 10, (0, 0, 0)))
    assert twin.shown_attributes != shown and scene.shown_attributes == shown


def test_lights_are_set_as_a_whole(sphere):
    scene = pr.Scene()
    sun, lamp, sky = pr.SunLight((0, 1, -1)), pr.PointLight((1, 2, 3), 4), pr.EnvironmentLight(0.2)
    assert scene.lights == () and scene.add_light(sun) == 0 and scene.add_light(sky) == 1
    assert scene.lights == (sun, sky)
    scene.lights = [lamp, sky]
    assert scene.lights == (lamp, sky)
    scene.lights = (light for light in (sky, sun, lamp))
    assert scene.lights == (sky, sun, lamp)
    scene.add(sphere)
    camera, by_hand = pr.Camera.frame(scene.bounds, size=(20, 20)), pr.Scene()
    by_hand.add(sphere)
    for light in (sky, sun, lamp):
        by_hand.add_light(light)
    assert np.array_equal(pr.render(scene, camera), pr.render(by_hand, camera))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (None, "sequence of lights, not None"),
        (pr.PointLight((0, 0, 0), 1), "sequence of lights, not PointLight"),
        ([pr.PointLight((0, 0, 0), 1), "sun"], "one of PointLight, .*EnvironmentLight, not 'sun'"),
        ([pr.EnvironmentLight(1), pr.EnvironmentLight(2)], "an EnvironmentLight already"),
    ],
)
def test_bad_lights_are_refused_and_change_nothing(wrong, message):
    scene = pr.Scene()
    scene.add_light(pr.SunLight((0, 1, -1)))
    before, version = scene.lights, scene._version
    with pytest.raises(ValueError, match=message):
        scene.lights = wrong
    assert scene.lights == before and scene._version == version


def test_every_change_is_counted(sphere):
    scene, versions = pr.Scene(), []

    def changed():
        versions.append(scene._version)
        return len(set(versions)) == len(versions) and versions == sorted(versions)

    assert changed()
    number = scene.add(sphere)
    assert changed()
    scene.update(number, np.eye(4))
    assert changed()
    scene.add_light(pr.PointLight((0, 0, 1), 1))
    assert changed()
    scene.lights = ()
    assert changed()
    scene.background = 0.5
    assert changed()
    scene.clips = [((0, 0, 1), (0, 0, 1))]
    assert changed()
    scene.remove(number)
    assert changed()
    scene.snapshot()
    assert scene._version == versions[-1] == scene.copy()._version
