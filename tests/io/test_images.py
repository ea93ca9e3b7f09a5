"""Image files: what is written is read back, for every file format, type and colour space."""

import os
import pathlib
import shutil
import stat
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import OpenImageIO as oiio
import pytest

from softras2d.io.images import (
    WRITABLE,
    decode_image,
    image_size,
    linear_to_srgb,
    read_image,
    srgb_to_linear,
    write_image,
)

from ..cases.png_files import png


def random_image(channels=3, height=5, width=7, seed=0):
    return np.random.default_rng(seed).random((height, width, channels), np.float32)


def save(path, pixels, kind="uint8", names=(), **attributes):
    """Write raw pixels with OpenImageIO alone. `__` in a keyword stands for `:`."""
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, kind)
    if names:
        spec.channelnames = names
    spec.attribute("oiio:UnassociatedAlpha", 1)
    for name, value in attributes.items():
        spec.attribute(name.replace("__", ":"), value)
    target = oiio.ImageOutput.create(str(path))
    assert target is not None
    assert target.open(str(path), spec) and target.write_image(pixels) and target.close()


def stored(path):
    """The raw pixels of a file, as bytes or floats."""
    hint = oiio.ImageSpec()
    hint.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(str(path), hint)
    assert source is not None
    spec = source.spec()
    return np.asarray(source.read_image(0, 0, 0, spec.nchannels, spec.format))


@pytest.mark.parametrize("suffix", [".png", ".tif", ".tiff", ".PNG"])
@pytest.mark.parametrize("channels", [3, 4])
def test_eight_bits_are_rounded_and_alpha_is_straight(tmp_path, suffix, channels):
    path = tmp_path / f"image{suffix}"
    image = random_image(channels)
    image[0, 0, -1] = 0.0
    write_image(path, image)
    read = read_image(path)
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read, np.rint(image * 255).astype(np.float32) / np.float32(255))


def test_all_bytes_survive_rounding_and_truncation(tmp_path):
    bytes_ = np.arange(256, dtype=np.float32)
    image = np.repeat((bytes_ / np.float32(255)).reshape(16, 16, 1), 3, axis=-1)
    for truncate in (False, True):
        write_image(tmp_path / "image.png", image, truncate=truncate)
        np.testing.assert_array_equal(stored(tmp_path / "image.png")[..., 0].ravel(), bytes_)
        np.testing.assert_array_equal(read_image(tmp_path / "image.png"), image)


def test_rounding_and_truncation_differ_between_bytes(tmp_path):
    image = np.full((1, 1, 3), 10.75 / 255, np.float32)
    write_image(tmp_path / "nearest.png", image)
    write_image(tmp_path / "floor.png", image, truncate=True)
    assert stored(tmp_path / "nearest.png")[0, 0, 0] == 11
    assert stored(tmp_path / "floor.png")[0, 0, 0] == 10


def test_eight_bits_are_clipped(tmp_path):
    image = np.array([[[-0.5, 0.5, 7.0]]], np.float32)
    write_image(tmp_path / "image.png", image)
    assert stored(tmp_path / "image.png").tolist() == [[[0, 128, 255]]]


def test_jpeg_is_nearly_the_image(tmp_path):
    ramp = np.linspace(0, 1, 64, dtype=np.float32)
    image = np.stack(np.broadcast_arrays(ramp[:, None], ramp[None, :], np.float32(0.3)), axis=-1)
    write_image(tmp_path / "image.jpg", image)
    assert np.abs(read_image(tmp_path / "image.jpg") - image).max() < 0.03


@pytest.mark.parametrize("suffix", WRITABLE)
def test_suffixes_in_capitals_mean_the_same(tmp_path, suffix):
    image = random_image(height=8, width=8)
    if suffix not in (".jpg", ".jpeg"):
        image = np.concatenate([image, image[..., :1]], axis=-1)
    write_image(tmp_path / f"image{suffix}", image)
    write_image(tmp_path / f"other{suffix.upper()}", image)
    in_capitals = read_image(tmp_path / f"other{suffix.upper()}")
    np.testing.assert_array_equal(in_capitals, read_image(tmp_path / f"image{suffix}"))


def test_srgb_curve_by_hand_and_its_inverse():
    # IEC 61966-2-1: 0.5 in sRGB is 0.21404 in linear light; the linear piece ends at 0.04045.
    assert srgb_to_linear(np.array([0.5], np.float32))[0] == pytest.approx(0.21404114, abs=1e-7)
    assert srgb_to_linear(np.array([0.04045], np.float32))[0] == pytest.approx(0.0031308, abs=1e-7)
    values = np.linspace(-0.5, 4.0, 1001, dtype=np.float32)
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(values)), values, atol=2e-6)


def test_linear_light_is_encoded_and_decoded(tmp_path):
    light = np.array([[[0.21404114, 0.0, 1.0, 0.25]]], np.float32)
    write_image(tmp_path / "image.png", light, linear=True)
    # Alpha is not converted.
    assert stored(tmp_path / "image.png").tolist() == [[[128, 0, 255, 64]]]
    read = read_image(tmp_path / "image.png", linear=True)
    np.testing.assert_allclose(read, [[[0.2158605, 0.0, 1.0, 64 / 255]]], atol=1e-6)


def test_every_byte_survives_linear_light(tmp_path):
    image = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, axis=-1)
    save(tmp_path / "a.png", image)
    write_image(tmp_path / "b.png", read_image(tmp_path / "a.png", linear=True), linear=True)
    np.testing.assert_array_equal(stored(tmp_path / "b.png"), image)


def test_exr_stores_linear_floats_bit_for_bit(tmp_path):
    image = random_image() * 5 - 1
    write_image(tmp_path / "image.exr", image, linear=True)
    np.testing.assert_array_equal(stored(tmp_path / "image.exr"), image)
    np.testing.assert_array_equal(read_image(tmp_path / "image.exr", linear=True), image)


def test_exr_stores_premultiplied_linear_light(tmp_path):
    image = np.array([[[0.5, 0.0, 1.0, 0.5], [0.3, 0.2, 0.1, 0.0]]], np.float32)
    write_image(tmp_path / "image.exr", image)
    raw = stored(tmp_path / "image.exr")
    np.testing.assert_allclose(raw, [[[0.10702057, 0, 0.5, 0.5], [0, 0, 0, 0]]], atol=1e-6)
    read = read_image(tmp_path / "image.exr")
    np.testing.assert_allclose(read, [[[0.5, 0, 1, 0.5], [0, 0, 0, 0]]], atol=1e-6)
    light = read_image(tmp_path / "image.exr", linear=True)
    np.testing.assert_allclose(light[0, 0], [0.21404114, 0, 1, 0.5], atol=1e-6)


def test_rgba_is_read_from_half_float_exr_with_more_channels(tmp_path):
    pixels = random_image(5)
    save(tmp_path / "image.exr", pixels, "half", ("Z", "B", "A", "R", "G"))
    read = read_image(tmp_path / "image.exr", linear=True)
    assert read.shape == (5, 7, 4)
    expected = pixels[..., [3, 4, 1]] / pixels[..., 2:3]
    np.testing.assert_allclose(read[..., :3], expected, rtol=2e-3, atol=2e-3)
    np.testing.assert_allclose(read[..., 3], pixels[..., 2], atol=1e-3)


def test_premultiplied_tiff_is_divided(tmp_path):
    pixels = np.array([[[64, 32, 0, 128]]], np.uint8)
    save(tmp_path / "image.tif", pixels, oiio__UnassociatedAlpha=0)
    read = read_image(tmp_path / "image.tif")
    np.testing.assert_allclose(read, [[[0.5, 0.25, 0, 128 / 255]]], atol=1e-6)


@pytest.mark.parametrize("channels", [1, 2], ids=["grey", "grey-alpha"])
def test_grey_becomes_rgb(tmp_path, channels):
    pixels = np.random.default_rng(0).integers(0, 256, (3, 4, channels), np.uint8)
    names = ("Y", "A")[:channels]
    save(tmp_path / "image.png", pixels, names=names)
    read = read_image(tmp_path / "image.png")
    assert read.shape == (3, 4, channels + 2)
    expected = pixels[..., [0, 0, 0, 1][: channels + 2]].astype(np.float32) / np.float32(255)
    np.testing.assert_array_equal(read, expected)


def test_sixteen_bits_are_read_exactly(tmp_path):
    pixels = np.array([[[0, 1, 65535], [256, 30000, 65534]]], np.uint16)
    save(tmp_path / "image.png", pixels, "uint16")
    expected = pixels.astype(np.float32) / np.float32(65535)
    np.testing.assert_array_equal(read_image(tmp_path / "image.png"), expected)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_images_are_rotated_by_their_exif_orientation(tmp_path, orientation):
    # The sides of the upright image to which the first stored row and column belong.
    row, column = {
        1: ("top", "left"), 2: ("top", "right"), 3: ("bottom", "right"), 4: ("bottom", "left"),
        5: ("left", "top"), 6: ("right", "top"), 7: ("right", "bottom"), 8: ("left", "bottom"),
    }[orientation]  # fmt: skip
    pixels = np.zeros((16, 32, 3), np.uint8)
    pixels[:8, :, 0] = 255  # red along the first row
    pixels[:, :8, 2] = 255  # blue along the first column
    save(tmp_path / "image.jpg", pixels, Orientation=orientation, compression="jpeg:100")
    read = read_image(tmp_path / "image.jpg")
    assert read.shape == ((16, 32, 3) if orientation < 5 else (32, 16, 3))
    assert image_size(tmp_path / "image.jpg") == read.shape[:2]
    side = {"top": read[:4], "bottom": read[-4:], "left": read[:, :4], "right": read[:, -4:]}
    assert side[row][..., 0].min() > 0.8
    assert side[column][..., 2].min() > 0.8


def test_bytes_are_decoded_without_a_suffix(tmp_path):
    image = random_image(4)
    write_image(tmp_path / "image.png", image)
    data = (tmp_path / "image.png").read_bytes()
    np.testing.assert_array_equal(
        decode_image(data, "image 3 of scene.svg"), read_image(tmp_path / "image.png")
    )
    with pytest.raises(ValueError, match=r"^image 3 of scene.svg: .*cut short"):
        decode_image(data[:-30], "image 3 of scene.svg")
    with pytest.raises(ValueError, match=r"^image 3 of scene.svg: not an image"):
        decode_image(b"", "image 3 of scene.svg")


def test_jax_arrays_and_double_precision_are_written(tmp_path):
    image = random_image()
    for number, same in enumerate((jnp.asarray(image), image.astype(np.float64))):
        write_image(tmp_path / f"{number}.png", same)
        np.testing.assert_array_equal(
            read_image(tmp_path / f"{number}.png"), np.rint(image * 255) / np.float32(255)
        )


def test_files_have_the_permissions_of_the_umask(tmp_path):
    before = os.umask(0o022)
    try:
        write_image(tmp_path / "image.png", random_image())
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "image.png").stat().st_mode) == 0o644


@pytest.mark.parametrize(
    ("name", "image", "message"),
    [
        ("image.gif", np.zeros((2, 2, 3)), "suffix must be one of"),
        ("image", np.zeros((2, 2, 3)), "suffix must be one of"),
        ("image.png", np.full((2, 2, 3), np.nan), "row 0, column 0, channel 0 is nan"),
        ("image.exr", np.full((2, 2, 3), np.inf), "row 0, column 0, channel 0 is inf"),
        ("image.png", np.zeros((2, 2)), r"got \(2, 2\)"),
        ("image.png", np.zeros((2, 0, 3)), r"got \(2, 0, 3\)"),
        ("image.png", np.zeros((2, 2, 3), np.uint8), "got uint8"),
        ("image.jpg", np.zeros((2, 2, 4)), "JPEG stores no alpha"),
        ("none/image.png", np.zeros((2, 2, 3)), "there is no folder"),
        ("folder.png", np.zeros((2, 2, 3)), "a folder"),
    ],
)
def test_refusals_to_write_are_one_line_and_leave_nothing(tmp_path, name, image, message):
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(ValueError, match=message) as caught:
        write_image(tmp_path / name, image)
    assert "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.png"]


def test_a_failure_leaves_the_old_file_and_no_draft(tmp_path, monkeypatch):
    write_image(tmp_path / "image.png", np.zeros((2, 2, 3)))
    before = (tmp_path / "image.png").read_bytes()

    def fail(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(KeyboardInterrupt):
        write_image(tmp_path / "image.png", np.ones((2, 2, 3)))
    assert [path.name for path in tmp_path.iterdir()] == ["image.png"]
    assert (tmp_path / "image.png").read_bytes() == before


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_full_disk_is_noticed_before_writing(tmp_path, monkeypatch, suffix):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1000))
    with pytest.raises(ValueError, match="not enough space"):
        write_image(tmp_path / f"image{suffix}", np.zeros((2, 2, 3)))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", sorted(set(WRITABLE) - {".jpeg", ".tiff"}))
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.95])
def test_files_cut_short_are_refused_in_one_line(tmp_path, capfd, suffix, share):
    complete = tmp_path / f"whole{suffix}"
    write_image(complete, random_image(height=64, width=64))
    data = complete.read_bytes()
    cut = tmp_path / f"cut{suffix}"
    cut.write_bytes(data[: int(share * len(data))])
    with pytest.raises(ValueError, match=r"cut short|not an image") as caught:
        read_image(cut)
    assert str(caught.value).startswith(f"{cut}: ") and "\n" not in str(caught.value)
    # With OpenImageIO 3.1, the OpenEXR library itself prints a line.
    assert suffix == ".exr" or capfd.readouterr().err == ""


def test_other_unreadable_paths_are_refused_in_one_line(tmp_path):
    (tmp_path / "text.png").write_text("hello")
    for name, message in (("none.png", "no such file"), (".", "a folder"), ("text.png", "not an")):
        with pytest.raises(ValueError, match=message) as caught:
            read_image(tmp_path / name)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("brand", "kind"), [(b"heic", "HEIC"), (b"avif", "AVIF")])
def test_formats_of_phones_say_what_to_do(tmp_path, brand, kind):
    path = tmp_path / "photo.jpg"
    path.write_bytes(b"\0\0\0\x18ftyp" + brand + bytes(40))
    with pytest.raises(ValueError) as caught:
        read_image(path)
    assert (
        str(caught.value) == f"{path}: {kind} is not read; save the picture as JPEG or PNG first."
    )


def test_a_file_that_claims_too_much_is_refused_unread(tmp_path):
    # The PNG header claims 100,000 x 100,000 pixels, but there are no data.
    (tmp_path / "image.png").write_bytes(png(100_000, 100_000, b""))
    with pytest.raises(ValueError, match=r"too many|not an image"):
        read_image(tmp_path / "image.png")


def _exr_with(tmp_path, old, new):
    """An EXR file in which the bytes `old` are replaced by `new`."""
    path = tmp_path / "broken.exr"
    write_image(path, random_image(3), linear=True)
    data = path.read_bytes()
    assert old in data and len(old) == len(new)
    path.write_bytes(data.replace(old, new))
    return path


@pytest.mark.parametrize(
    "old, new",
    [
        (b"channels\0", b"\xfehannels\0"),
        (b"channels\0chlist\0", b"channels\0chli\xffs\0"),
        (b"dataWindow\0", b"data\xc3indow\0"),
    ],
)
def test_names_that_are_not_utf8_are_refused_in_one_line(tmp_path, old, new):
    """OpenImageIO passes such names on unchanged, and Python cannot decode them."""
    path = _exr_with(tmp_path, old, new)
    with pytest.raises(ValueError, match=r"broken\.exr: ") as caught:
        read_image(path)
    message = str(caught.value)
    assert "\n" not in message and message.count("broken.exr") == 1 and message.isprintable()


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_values_that_are_not_finite_are_named_when_read(tmp_path, value):
    pixels = random_image(3)
    pixels[2, 3, 1] = value
    save(tmp_path / "image.exr", pixels, "float")
    with pytest.raises(ValueError, match=r"image\.exr: row 2, column 3, channel 1 is"):
        read_image(tmp_path / "image.exr")


def test_colors_that_overflow_are_named(tmp_path):
    """Colours may overflow when divided by an alpha near 0, or when converted to linear."""
    save(tmp_path / "thin.exr", np.full((1, 1, 4), [1e10, 0, 0, 1e-35], np.float32), "float")
    with pytest.raises(ValueError, match=r"thin\.exr: row 0, column 0, channel 0 is inf"):
        read_image(tmp_path / "thin.exr")
    with pytest.raises(ValueError, match=r"a\.exr: row 0, column 0, channel 0 is inf"):
        write_image(tmp_path / "a.exr", np.full((1, 1, 3), 1e30, np.float32))
    with pytest.raises(ValueError, match=r"a\.png: row 0, column 0, channel 0 is inf"):
        write_image(tmp_path / "a.png", np.full((1, 1, 3), 1e300))


HOSTILE = os.environ.get("SOFTRAS2D_DATA")


@pytest.mark.skipif(HOSTILE is None, reason="SOFTRAS2D_DATA is not set")
def test_hostile_images_are_refused_in_one_line():
    for path in sorted(pathlib.Path(HOSTILE or "", "hostile").glob("*.exr")):
        with pytest.raises(ValueError) as caught:
            read_image(path)
        assert str(caught.value).startswith(f"{path}: ")
        assert len(str(caught.value).splitlines()) == 1
