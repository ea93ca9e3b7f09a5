"""Pictures of an SVG file in a browser: what is measured, and browsers that fail or hang.

Most tests run a shell script instead of a browser. Pictures of a real one are tested in
`io/svg/test_in_browser.py` and `cli/test_fit_browser.py`.
"""

import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

import softras2d as sr
from softras2d.comparison.chromium import BROWSERS, find_browser
from softras2d.comparison.screenshot import FAR_LEVELS, screenshot, screenshot_difference

from ..cases.browser import fake_browser, require_browser

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the scripts need a shell")

RNG = np.random.default_rng(0)
IMAGE = (RNG.integers(0, 256, (6, 9, 3)) / 255).astype(np.float32)


@pytest.fixture
def svg(tmp_path, monkeypatch):
    """An SVG file. Temporary files of the test are in the folder `temporary` beside it."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    path = tmp_path / "scene.svg"
    path.write_text("<svg xmlns='http://www.w3.org/2000/svg'/>")
    return path


def temporary_files(svg: Path) -> list[Path]:
    return list((svg.parent / "temporary").iterdir())


def test_measures_equal_their_formulas():
    levels = np.round(255 * IMAGE).astype(int)
    shown = levels.copy()
    shown[2, 3, 1] += -30 if shown[2, 3, 1] > 100 else 30
    shown[4, 0, 2] += -FAR_LEVELS if shown[4, 0, 2] > 100 else FAR_LEVELS
    difference = screenshot_difference((shown / 255).astype(np.float32), IMAGE)
    assert difference.mean == pytest.approx((30 + FAR_LEVELS) / IMAGE.size, rel=1e-4)
    assert difference.largest == pytest.approx(30, rel=1e-4)
    assert difference.far_share == pytest.approx(1 / 54)
    mse = (30**2 + FAR_LEVELS**2) / 255**2 / IMAGE.size
    assert difference.psnr == pytest.approx(-10 * np.log10(mse), rel=1e-4)
    assert str(difference) == (
        f"mean difference {difference.mean:.2f} levels of 255, largest 30; 1.85 % of pixels differ "
        f"by more than 24 levels; PSNR {difference.psnr:.2f} dB"
    )


def test_an_exact_picture_differs_in_no_pixel():
    between_levels = IMAGE * np.float32(0.999)
    shown = np.round(255 * between_levels) / np.float32(255)
    assert screenshot_difference(shown, between_levels) == (0, 0, 0, np.inf)


def test_alpha_is_composited_over_the_white_page():
    expected = np.dstack([IMAGE, np.full((6, 9), 0.5, np.float32)])
    shown = np.floor(255 * (IMAGE * 0.5 + 0.5) + 0.5) / 255
    assert screenshot_difference(shown.astype(np.float32), expected).largest == 0


def test_browsers_are_found_by_name_and_by_path(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert find_browser() is None
    path = fake_browser(tmp_path, "")
    assert find_browser("fake-browser") == path
    assert find_browser(path) == path
    (tmp_path / "google-chrome").symlink_to(path)
    assert find_browser() == find_browser("google-chrome") == str(tmp_path / "google-chrome")
    assert find_browser("chromium-browser") is None
    (tmp_path / BROWSERS[0]).symlink_to(path)
    assert find_browser() == str(tmp_path / "chromium")


def test_the_margin_of_the_window_is_cut_off(svg):
    window = np.ones((600, 600, 3), np.float32)
    window[:6, :9] = IMAGE
    sr.write_image(svg.with_name("window.png"), window)
    browser = fake_browser(svg.parent, f"cp {svg.with_name('window.png')} $picture; exit 1")
    np.testing.assert_array_equal(screenshot(browser, svg, height=6, width=9), IMAGE)
    assert not temporary_files(svg)


@pytest.mark.parametrize(
    ("script", "kind", "message"),
    [
        ("echo; echo no display >&2; exit 3", OSError, "it ended with exit code 3: no display"),
        ("kill -SEGV $$", OSError, "it ended with exit code -11: it printed nothing"),
        ("echo more than $picture", OSError, "it ended with exit code 0: more than /"),
        ("cp SMALL $picture", OSError, "has 9 x 6 of 9 x 7 pixels"),
        ("echo no image > $picture", ValueError, "the picture of"),
    ],
)
def test_failures_are_one_line(svg, script, kind, message):
    small = svg.with_name("small.png")
    sr.write_image(small, IMAGE)
    browser = fake_browser(svg.parent, script.replace("SMALL", str(small)))
    with pytest.raises(kind) as error:
        screenshot(browser, svg, height=7, width=9)
    assert message in str(error.value) and "\n" not in str(error.value)
    assert str(svg) in str(error.value) and browser in str(error.value)
    assert not temporary_files(svg)


def test_a_failure_that_passes_is_tried_again(svg):
    sr.write_image(svg.with_name("small.png"), IMAGE)
    tried = svg.with_name("tried")
    copy = f"cp {svg.with_name('small.png')} $picture"
    browser = fake_browser(svg.parent, f"if test -e {tried}; then {copy}; fi; touch {tried}")
    np.testing.assert_array_equal(screenshot(browser, svg, height=6, width=9), IMAGE)


def is_running(number: int) -> bool:
    """Whether a process with this number exists and is no zombie."""
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{number}/stat")
    return not status.exists() or status.read_text().rpartition(")")[2].split()[0] != "Z"


def test_a_browser_that_hangs_is_ended_with_all_its_processes(svg):
    numbers = svg.with_name("numbers")
    script = f"sleep 300 & echo $! > {numbers}; echo $$ >> {numbers}; touch $picture.part; wait"
    browser = fake_browser(svg.parent, script)
    with pytest.raises(TimeoutError, match=r"made no picture of .*scene.svg within 5 s.$"):
        screenshot(browser, svg, height=7, width=9, seconds=5)
    limit = time.monotonic() + 10
    while any(is_running(int(number)) for number in numbers.read_text().split()):
        assert time.monotonic() < limit
        time.sleep(0.05)
    assert len(numbers.read_text().split()) == 2
    assert not temporary_files(svg)


def test_a_file_that_is_no_program_is_named(svg):
    browser = svg.with_name("not-a-program")
    browser.write_bytes(b"\0\1\2")
    browser.chmod(0o755)
    with pytest.raises(OSError, match="not-a-program"):
        screenshot(str(browser), svg, height=7, width=9)
    assert not temporary_files(svg)


@pytest.mark.slow
def test_a_real_browser_leaves_no_files(svg, monkeypatch):
    home = svg.with_name("home")
    home.mkdir()
    monkeypatch.setenv("HOME", str(home))
    for name in ("XDG_CONFIG_HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    shown = screenshot(require_browser(), svg, height=7, width=9)
    np.testing.assert_array_equal(shown, np.ones((7, 9, 3), np.float32))
    assert not temporary_files(svg)
    # GNOME's settings service may add a file of its own.
    assert {path.name for path in home.rglob("*")} <= {".cache", "dconf", "user"}
