"""Written GIF animations have the given frames and times, and errors are one line."""

import re

import jax.numpy as jnp
import numpy as np
import OpenImageIO as oiio
import pytest

from softras2d.io import gif
from softras2d.io.animation import ANIMATED, write_animation

RNG = np.random.default_rng(5)


def moving_disc(count=4, height=40, width=60):
    """Frames of a shaded disc that moves over white, and of a spot of six pixels."""
    row, column = np.mgrid[:height, :width].astype(np.float32)
    frames = np.ones((count, height, width, 3), np.float32)
    for k, frame in enumerate(frames):
        inside = (row - 20) ** 2 + (column - 15 - 8 * k) ** 2 < 144
        shaded = np.stack([column / width, row / height, 1 - column / width], axis=-1)
        frame[inside] = shaded[inside]
        frame[2:4, 2:5] = (1, 0, 0)
    return frames


def read_frames(path):
    """The frames that a viewer shows, `[n, height, width, 3]` in 0..1, and their seconds."""
    source = oiio.ImageInput.open(str(path))
    assert source is not None
    pictures, seconds = [], []
    while source.seek_subimage(len(pictures), 0):
        spec = source.spec()
        raw = np.asarray(source.read_image(len(pictures), 0, 0, spec.nchannels, "uint8"))
        assert not source.geterror()
        before = pictures[-1] if pictures else np.zeros_like(raw[..., :3])
        # Where a frame leaves the last one visible, OpenImageIO gives alpha 0.
        drawn = raw[..., 3:] > 0 if raw.shape[-1] == 4 else True
        pictures.append(np.where(drawn, raw[..., :3], before))
        numerator, denominator = spec.getattribute("FramesPerSecond")
        seconds.append(denominator / numerator)
    return np.array(pictures) / 255.0, seconds


def test_frames_are_read_back_in_nearly_the_same_colours(tmp_path):
    frames = moving_disc()
    write_animation(tmp_path / "a.gif", frames)
    pictures, seconds = read_frames(tmp_path / "a.gif")
    assert pictures.shape == frames.shape
    assert seconds == [0.1, 0.1, 0.1, 1.1]
    error = np.abs(pictures - frames)
    assert error.max() < 0.1 and error.mean() < 0.004
    assert error[(frames == 1).all(axis=-1)].max() == 0
    assert error[:, 2:4, 2:5].max() == 0


def test_it_repeats_endlessly(tmp_path):
    write_animation(tmp_path / "a.gif", moving_disc(2))
    source = oiio.ImageInput.open(str(tmp_path / "a.gif"))
    assert source is not None
    assert source.spec().get_int_attribute("gif:LoopCount", -1) == 0


def test_few_colours_are_exact_and_clipped(tmp_path):
    frames = RNG.choice(np.array([-0.5, 0.2, 0.6, 1.5]), (5, 9, 7, 3))
    write_animation(tmp_path / "a.GIF", frames)
    np.testing.assert_allclose(
        read_frames(tmp_path / "a.GIF")[0], np.clip(frames, 0, 1), atol=1e-12
    )


@pytest.mark.parametrize("size", [(1, 1), (1, 300), (300, 1), (33, 65)], ids=str)
def test_any_size_and_unchanged_frames_are_read_back_exactly(tmp_path, size):
    unchanged = RNG.integers(0, 6, (*size, 3)) / 5
    write_animation(tmp_path / "a.gif", [unchanged, unchanged, 1 - unchanged, 1 - unchanged])
    pictures, _ = read_frames(tmp_path / "a.gif")
    expected = [unchanged, unchanged, 1 - unchanged, 1 - unchanged]
    np.testing.assert_allclose(pictures, expected, atol=1e-12)


def test_unchanged_frames_take_few_bytes(tmp_path):
    unchanged = RNG.random((64, 64, 3))
    write_animation(tmp_path / "one.gif", [unchanged])
    write_animation(tmp_path / "ten.gif", [unchanged] * 10)
    # Each unchanged frame takes a palette of 768 bytes, and one pixel.
    sizes = [(tmp_path / name).stat().st_size for name in ("one.gif", "ten.gif")]
    assert sizes[1] - sizes[0] < 9 * 820


def test_frames_have_the_given_seconds(tmp_path):
    for each, hold, wanted in ((0.02, 0.0, [0.02, 0.02]), (0.349, 600.0, [0.35, 600.35])):
        write_animation(
            tmp_path / "a.gif", moving_disc(2), seconds_per_frame=each, hold_seconds=hold
        )
        assert read_frames(tmp_path / "a.gif")[1] == pytest.approx(wanted)


def test_a_generator_of_jax_arrays_is_written(tmp_path):
    frames = moving_disc(3)
    write_animation(tmp_path / "a.gif", (jnp.asarray(frame) for frame in frames))
    write_animation(tmp_path / "b.gif", frames.astype(np.float64))
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()


@pytest.mark.parametrize("count", [1, 255, 256, 257, 3837, 3838, 3839, 3840, 3841, 9000])
def test_every_length_of_code_is_read_back(tmp_path, count):
    # Noise hardly repeats, so each pixel adds a code, and 3838 pixels fill the table.
    indices = RNG.integers(0, 256, (1, count)).astype(np.uint8)
    grey = np.arange(256, dtype=np.uint8).repeat(3).reshape(256, 3)
    frame = gif.frame(indices, grey, top=0, left=0, delay=2)
    (tmp_path / "a.gif").write_bytes(gif.header(1, count) + frame + gif.TRAILER)
    pictures, _ = read_frames(tmp_path / "a.gif")
    np.testing.assert_array_equal(np.rint(pictures[0, :, :, 0] * 255), indices)


ONE = np.zeros((2, 3, 3))
REFUSED = {
    "suffix": ("a.png", [ONE], {}, "the suffix must be .gif"),
    "folder": ("none/a.gif", [ONE], {}, "there is no folder"),
    "is-folder": ("folder.gif", [ONE], {}, "a folder"),
    "none": ("a.gif", [], {}, "there are no frames"),
    "sizes": ("a.gif", [ONE, np.zeros((3, 2, 3))], {}, "frame 0, (2, 3, 3); got (3, 2, 3)"),
    "alpha": ("a.gif", [np.zeros((2, 3, 4))], {}, "frame 0: a frame is [height, width, 3]; got"),
    "empty": ("a.gif", [np.zeros((0, 3, 3))], {}, "frame 0: an image is"),
    "bytes": ("a.gif", [ONE.astype(np.uint8)], {}, "frame 0: an image holds floats"),
    "nan": ("a.gif", [ONE, ONE + np.nan], {}, "frame 1: row 0, column 0, channel 0 is nan"),
    "large": ("a.gif", [np.zeros((65536, 1, 3))], {}, "at most 65535 pixels a side"),
    "fast": ("a.gif", [ONE], {"seconds_per_frame": 0.01}, "`seconds_per_frame` must be 0.02 to"),
    "nan-time": ("a.gif", [ONE], {"hold_seconds": np.nan}, "`hold_seconds` must be 0.0 to"),
    "slow": ("a.gif", [ONE], {"hold_seconds": 655.3}, "at most 655.35 seconds; got 655.4"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals_are_one_line_and_leave_nothing(tmp_path, case):
    name, frames, options, message = REFUSED[case]
    (tmp_path / "folder.gif").mkdir()
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        write_animation(tmp_path / name, frames, **options)
    assert "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.gif"]
    assert ANIMATED == (".gif",)


def test_a_failure_halfway_leaves_the_old_file(tmp_path):
    (tmp_path / "a.gif").write_bytes(b"old")

    def interrupted():
        yield from moving_disc(2)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_animation(tmp_path / "a.gif", interrupted())
    assert [path.name for path in tmp_path.iterdir()] == ["a.gif"]
    assert (tmp_path / "a.gif").read_bytes() == b"old"


def test_a_full_disk_is_one_line(tmp_path):
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
    try:
        with pytest.raises(ValueError, match="cannot be written: File too large") as caught:
            write_animation(tmp_path / "a.gif", RNG.random((3, 64, 64, 3)))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())
