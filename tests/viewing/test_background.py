"""The thread that compiles plans in the background, when it is closed."""

import threading

import pytest

from softras2d.viewing import background
from softras2d.viewing.background import PlanCompiler
from softras2d.viewing.settings import Settings
from softras2d.viewing.view import View

from ..cases.viewing import small_scene


def test_a_plan_that_still_waits_is_dropped_when_the_compiler_is_closed(
    monkeypatch: pytest.MonkeyPatch,
):
    has_begun, may_end = threading.Event(), threading.Event()

    def compile_slowly(*arguments: object) -> None:
        has_begun.set()
        assert may_end.wait(10)
        raise ValueError("no plan")

    monkeypatch.setattr(background, "_compile", compile_slowly)
    compiler, scene, view = PlanCompiler(), small_scene(), View(1.0, 0, 0, 16, 16)
    compiler.start("first", scene, view, Settings())
    assert has_begun.wait(10)
    compiler.start("waiting", scene, view, Settings())
    # The first plan ends only after the second was dropped.
    compiler._plans["waiting"].add_done_callback(lambda plan: may_end.set())
    compiler.close()
    assert compiler.take("first") is None
    assert compiler.take("waiting") is None
    assert compiler.take("unknown") is None
