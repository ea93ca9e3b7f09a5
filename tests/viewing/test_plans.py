"""A large canvas is drawn with a tight plan while another thread compiles a plan with headroom."""

from collections.abc import Iterator

import numpy as np
import pytest

import softras2d as sr
from softras2d.viewing import draw, plans
from softras2d.viewing.draw import Artist
from softras2d.viewing.plans import kind_of
from softras2d.viewing.scene_in_memory import enlarge
from softras2d.viewing.settings import Settings
from softras2d.viewing.view import View

from ..cases.viewing import bytes_of, small_scene

pytestmark = pytest.mark.slow

SETTINGS = Settings(samples=1)
VIEW = View(0.5, -16, -12, 48, 64)


def crowd(copies: int) -> sr.Scene:
    """A scene of `copies` copies of the small scene, one over another."""
    scene = small_scene(channels=4)
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)]
    return sr.Scene.from_soup(
        np.tile(corners, (copies, 1, 1)), np.tile(np.asarray(scene.colors)[:, 0], (copies, 1))
    )


@pytest.fixture
def artist(monkeypatch: pytest.MonkeyPatch) -> Iterator[Artist]:
    """An `Artist` that treats every canvas as large."""
    monkeypatch.setattr(plans, "TIGHT_PLAN_PIXELS", 1)
    monkeypatch.setattr(draw, "TIGHT_PLAN_PIXELS", 1)
    artist = Artist()
    yield artist
    artist.close()


def test_a_zoom_that_outgrows_the_tight_plan_uses_the_one_that_was_compiled(
    artist, count_compilations
):
    # The triangles are so many that lists of tiles exceed a plan's least capacity when zoomed in.
    scene = crowd(40)
    small = enlarge(scene, 0.5, 0.5)
    first = artist.draw(small, VIEW, SETTINGS)
    artist.prepare_zoom(small, VIEW, SETTINGS)
    compiled_plan = artist._compiler.take(kind_of(small, VIEW, SETTINGS))
    assert compiled_plan is not None and compiled_plan.capacity.pairs > first.plan.capacity.pairs
    zoomed = View(1.0, 0, 0, 48, 64)
    with count_compilations() as compiled:
        second = artist.draw(scene, zoomed, SETTINGS)
        third = artist.draw(scene, zoomed, SETTINGS)
    assert compiled.names == []
    assert second.plan.capacity == third.plan.capacity == compiled_plan.capacity
    view = {"height": 48, "width": 64, "x": 0, "y": 0}
    expected = bytes_of(scene, view, SETTINGS.coverage_option())
    np.testing.assert_array_equal(second.rgba[..., :3], expected)


def test_after_closing_nothing_is_compiled(artist):
    artist.close()
    artist.prepare_zoom(small_scene(), VIEW, SETTINGS)
    assert not artist.is_compiling()
