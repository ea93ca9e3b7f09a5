"""The thread that watches for changes serves all widgets, even if one of them fails."""

import threading
from itertools import count

import pytest

from softras2d.viewing.shared_threads import Watcher


@pytest.mark.parametrize("failing", ["versions", "tell"])
def test_a_widget_that_fails_is_forgotten_and_others_are_told(failing, caplog):
    numbers, is_told = count(), threading.Event()

    def versions() -> list[int]:
        number = next(numbers)
        if failing == "versions" and number:
            raise RuntimeError("it is\ngone")
        return [number]

    def tell(versions: list[int]) -> None:
        raise RuntimeError("it is\ngone")

    def note(versions: list[int]) -> None:
        if versions[0] > 5:
            watcher.forget("sound")
            is_told.set()

    watcher, changes = Watcher(0.001), count()
    watcher.watch("broken", versions, tell)
    watcher.watch("sound", lambda: [next(changes)], note)
    assert is_told.wait(10)
    assert [record.getMessage() for record in caplog.records] == [
        "changes are no longer watched for a widget: it is gone"
    ]
