import numpy as np
import pytest
from PIL import Image

import pointray as pr
from pointray.image import filmic, linear_to_srgb, srgb_to_linear, tone, write_image
from pointray.image.exposure import auto_exposure, auto_tone, tone_of, white_under
from pointray.image.tone import neutral, soft

BYTES = np.arange(256, dtype=np.uint8)
GRAY = np.full((4, 6, 3), 0.25, np.float32)


def load(path):
    return np.asarray(Image.open(path))


def rgba(color, alpha):
    return np.tile(np.float32([*(np.float32(color) * alpha), alpha]), (4, 6, 1))


def test_srgb_known_values():
    linear = srgb_to_linear(np.array([0, 10, 11, 128, 188, 255], np.uint8))
    np.testing.assert_allclose(linear, [0, 0.0030353, 0.0033465, 0.2158605, 0.5028865, 1], rtol=1e-4)
    np.testing.assert_allclose(
        linear_to_srgb(np.float32([0, 0.0031308, 0.2140411, 1])), [0, 0.04045, 0.5, 1], atol=1e-5
    )


def test_srgb_is_inverted():
    np.testing.assert_array_equal(np.rint(linear_to_srgb(srgb_to_linear(BYTES)) * 255), BYTES)
    np.testing.assert_allclose(srgb_to_linear(BYTES), srgb_to_linear(BYTES / 255), rtol=1e-6)
    assert srgb_to_linear(BYTES.reshape(16, 16)).shape == (16, 16)


def test_filmic_rises_from_0_to_1():
    curve = filmic(np.geomspace(1e-6, 1e30, 1000).astype(np.float32))
    assert (np.diff(curve) >= 0).all()
    assert curve[0] < 1e-6
    assert curve[-1] == 1
    assert filmic(np.float32([1]))[0] == pytest.approx(2.54 / 3.16)  # Narkowicz' fit at 1


def test_an_exposure_stop_doubles():
    np.testing.assert_allclose(tone(GRAY, exposure=1), 0.5)
    np.testing.assert_allclose(tone(GRAY, exposure=-2, curve="filmic"), filmic(np.full_like(GRAY, 0.0625)))


def test_nan_is_black():
    values = np.float32([np.nan, np.inf, -np.inf, -1, 3])
    for curve in ("srgb", "neutral", "filmic"):
        shown = tone(values, 3, curve)
        assert shown[[0, 2, 3]].tolist() == [0, 0, 0]
        assert shown[1] == 1


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.JPEG"])
def test_opaque_images_have_three_channels(tmp_path, name):
    for image in (GRAY, rgba([0.25] * 3, 1), GRAY.astype(np.float64)):
        write_image(tmp_path / name, image)
        picture = load(tmp_path / name)
        assert picture.shape == (4, 6, 3)
        assert np.abs(picture.astype(int) - 137).max() <= 1
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_colors_of_files_are_unchanged(tmp_path):
    ramp = np.stack([BYTES, BYTES[::-1], BYTES], axis=1)[None]
    write_image(tmp_path / "a.png", srgb_to_linear(ramp))
    np.testing.assert_array_equal(load(tmp_path / "a.png"), ramp)


def test_alpha_is_kept_and_colors_are_unpremultiplied(tmp_path):
    write_image(tmp_path / "a.png", rgba([1, 0.25, 0], 0.5))
    picture = load(tmp_path / "a.png")
    assert picture.shape == (4, 6, 4)
    assert picture[0, 0].tolist() == [255, 137, 0, 128]
    write_image(tmp_path / "a.png", np.zeros((4, 6, 4), np.float32))
    assert not load(tmp_path / "a.png").any()


def test_a_jpeg_shows_the_image_on_white(tmp_path):
    write_image(tmp_path / "a.jpg", np.zeros((4, 6, 4), np.float32), curve="filmic")
    assert load(tmp_path / "a.jpg").min() >= 254
    write_image(tmp_path / "a.jpg", rgba([0, 0, 0], 0.5))
    assert np.abs(load(tmp_path / "a.jpg").astype(int) - 188).max() <= 1


def test_nan_and_infinity_do_no_harm(tmp_path):
    image = rgba([0.25] * 3, 1)
    image[0, 0], image[1, 1], image[2, 2, 3] = np.nan, [np.inf, 0, 0, 1], np.nan
    write_image(tmp_path / "a.png", image)
    picture = load(tmp_path / "a.png")
    assert picture[0, 0].tolist() == [0, 0, 0, 0]
    assert picture[1, 1].tolist() == [255, 0, 0, 255]
    assert picture[2, 2, 3] == 0
    assert picture[3, 3].tolist() == [137, 137, 137, 255]


@pytest.mark.parametrize(
    ("name", "image", "others", "message"),
    [
        ("a.bmp", GRAY, {}, r"cannot write \.bmp; supported: \.png, \.jpg"),
        ("a", GRAY, {}, "without extension"),
        ("a.png", GRAY[0], {}, r"\(6, 3\)"),
        ("a.png", GRAY[..., :2], {}, r"\(4, 6, 2\)"),
        ("a.png", np.zeros((0, 6, 3)), {}, r"\(0, 6, 3\)"),
        ("a.png", np.zeros((4, 6, 3), np.uint8), {}, "float"),
        ("a.png", GRAY, {"curve": "log"}, "srgb, neutral"),
        ("a.png", GRAY, {"exposure": np.nan}, "exposure"),
    ],
)
def test_invalid_images_are_refused(tmp_path, name, image, others, message):
    with pytest.raises(ValueError, match=message):
        write_image(tmp_path / name, image, **others)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_an_oserror(tmp_path):
    with pytest.raises(FileNotFoundError, match="folder not found"):
        write_image(tmp_path / "none" / "a.png", GRAY)


def spotted(dark, share=0.02):
    """A dark picture with some bright spots."""
    image = np.full((100, 100, 4), dark, np.float32)
    image[..., 3] = 1
    image.reshape(-1, 4)[:: round(1 / share), :3] = 1
    return image


def test_a_few_bright_spots_do_not_darken_the_rest():
    """The soft curve is chosen if the rest would be dark; spots are then not brighter than by the plain one."""
    stops, curve = auto_tone(spotted(0.01))
    assert curve == "soft" and stops > auto_exposure(spotted(0.01)) + 2
    shown = linear_to_srgb(tone(spotted(0.01)[..., :3], stops, curve)) * 255
    assert 240 < shown.max() < 250 and shown.min() > 60
    assert auto_tone(spotted(0.2)) == (auto_exposure(spotted(0.2), "neutral"), "neutral")
    assert tone_of(spotted(0.01), "auto", "srgb") == (auto_exposure(spotted(0.01)), "srgb")
    assert tone_of(spotted(0.01), 1.5, "auto") == (1.5, "srgb")


@pytest.mark.parametrize(("albedo", "level"), [(0.8, 130), (0.18, 130), (0.05, 100), (0.03, 80)])
def test_dark_surfaces_stay_darker_than_bright_ones(albedo, level):
    """In the studio's light; without a limit all are shown at level 130."""
    white = white_under(pr.studio(azimuth=0), "baked")
    assert white == pytest.approx(1 + 0.283, abs=0.01)  # the key light and the sky: no surface faces the rim light too
    image = np.full((20, 20, 4), [0.8 * white * albedo] * 3 + [1.0], np.float32)
    stops, curve = auto_tone(image, white)
    shown = 255 * linear_to_srgb(tone(image[0, 0, :3], stops, curve))
    assert curve == "neutral" and shown == pytest.approx([level] * 3, abs=10)


def test_white_is_known_under_suns_skies_and_headlights_only():
    sun, lamp = pr.SunLight((0, 0, -1), 2 * np.pi), pr.PointLight((0, 0, 5), 10)
    assert white_under([sun]) == pytest.approx(2)
    assert white_under([sun, pr.EnvironmentLight(0.5)]) == pytest.approx(2.5, rel=1e-3)
    assert white_under([]) == white_under([lamp], "ao") == 1
    aside, behind = pr.SunLight((-1, 0, 0), np.pi), pr.SunLight((0, 0.6, 0.8), np.pi)
    assert white_under([sun, aside]) == pytest.approx(np.hypot(2, 1))  # it faces a direction between them
    assert white_under([sun, behind]) == pytest.approx(2)
    along = pr.SunLight((0, 0, 1), np.pi, camera=True)  # it may come from any direction
    assert white_under([sun, along]) == pytest.approx(3)
    assert white_under([sun, lamp]) is white_under([], "path") is white_under([pr.SunLight((0, 0, -1), 0)]) is None


def khronos(x):
    """Return grey by the specification of PBR Neutral, with this project's 0.01 instead of 0.04."""
    x = x - (x - x * x / 0.04 if x < 0.02 else 0.01)
    start = 0.8 - 0.01
    return x if x < start else 1 - (1 - start) ** 2 / (x + 1 - 2 * start)


def test_the_neutral_curve_equals_its_specification():
    x = np.geomspace(1e-4, 1e4, 2000).astype(np.float32)
    y = neutral(x)
    np.testing.assert_allclose(y, [khronos(float(v)) for v in x], rtol=1e-5, atol=1e-7)
    assert (np.diff(y) >= 0).all() and y[-1] == pytest.approx(1, abs=1e-4)
    assert neutral(np.float32([0, 0.2, np.inf])).tolist() == pytest.approx([0, 0.19, 1])


def test_the_soft_curve_rises_from_black_to_white():
    x = np.linspace(0, 20, 1000, dtype=np.float32)
    y = soft(x)
    assert (
        y[0] == 0 and (np.diff(y) >= 0).all() and y[-1] == 1 and soft(np.float32(1)) == pytest.approx(0.502, abs=1e-3)
    )
    assert soft(np.float32(1e-3)) == pytest.approx(1e-3, rel=2e-3)


def test_a_curve_may_be_chosen_with_the_exposure(tmp_path):
    for image, curve in ((spotted(0.01), "soft"), (spotted(0.2), "neutral")):
        pr.write_image(tmp_path / "auto.png", image, "auto", "auto")
        pr.write_image(tmp_path / "said.png", image, auto_exposure(image, curve), curve)
        assert (tmp_path / "auto.png").read_bytes() == (tmp_path / "said.png").read_bytes()
    with pytest.raises(ValueError, match="curve"):
        pr.write_image(tmp_path / "a.png", spotted(0.2), "auto", "softer")
