"""A fit that the viewer shows ends as soon as no page waits for its last picture."""

import threading

import numpy as np
import pytest

import softras2d as sr
from softras2d.viewing.image import Image
from softras2d.viewing.session import Session
from softras2d.viewing.watched_fit import WatchedFit

from ..cases.viewing import HEIGHT, WIDTH, small_image, small_scene

HOUR = 3600.0
"""A number of seconds that is longer than any test may take."""

RESULT = sr.FitResult(small_scene(), np.zeros((HEIGHT, WIDTH, 3), np.float32), 9.0, 0.5, (), {})


class Finishing:
    """A thread that calls `finish` of a fit."""

    def __init__(self, fit: WatchedFit):
        self._has_ended = threading.Event()
        self._thread = threading.Thread(target=self._run, args=[fit], daemon=True)
        self._thread.start()

    def _run(self, fit: WatchedFit) -> None:
        fit.finish(RESULT, HOUR)
        self._has_ended.set()

    def has_ended(self, seconds: float) -> bool:
        """Whether `finish` returns within some seconds."""
        return self._has_ended.wait(seconds)


@pytest.fixture
def fit() -> WatchedFit:
    return WatchedFit("fit", HEIGHT, WIDTH)


@pytest.fixture
def session(fit: WatchedFit) -> Session:
    return Session([fit, Image("image", small_image)])


def test_without_a_page_a_fit_ends_at_once(fit):
    assert Finishing(fit).has_ended(30)
    assert np.array_equal(fit.scene_at(1.0).triangles, small_scene().triangles)


def test_a_fit_waits_until_its_end_is_told_and_its_last_scene_drawn(fit, session):
    session.set_shown_subject("page", 0)
    fit.fit_state()
    fit.scene_at(1.0)
    finishing = Finishing(fit)
    assert not finishing.has_ended(0.3)
    # The answer to a request from before the end may show the last scene.
    fit.scene_at(1.0)
    assert not finishing.has_ended(0.3)
    fit.fit_state()
    assert finishing.has_ended(30)


@pytest.mark.parametrize("number", [1, None])
def test_a_fit_does_not_wait_for_pages_that_show_something_else(fit, session, number):
    session.set_shown_subject("page", 0)
    session.set_shown_subject("other", 1)
    fit.scene_at(1.0)
    finishing = Finishing(fit)
    assert not finishing.has_ended(0.3)
    session.set_shown_subject("page", number)
    assert finishing.has_ended(30)
