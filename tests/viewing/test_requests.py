"""Valid requests are read, and others are refused in one line."""

import json

import numpy as np
import pytest

from softras2d.viewing.frames import frames_of
from softras2d.viewing.message_fields import read_fields
from softras2d.viewing.session import Reply
from softras2d.viewing.settings import Settings
from softras2d.viewing.view import View, enlarged_size

from ..cases.viewing import VIEW, ask, small_session, unpacked


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"kind": "nothing"}, "no request of kind 'nothing'"),
        ({"view": VIEW | {"x": 10**400}}, "`x` must be a whole number"),
        ({"view": VIEW | {"zoom": 10**400}}, "`zoom` must be a finite number"),
        ({"subject": 2}, "`subject` must be 0 to 1"),
        ({"subject": "a"}, "`subject` must be a whole number"),
        ({"subject": True}, "`subject` must be a whole number"),
        ({"view": None}, "View must be an object"),
        ({"view": VIEW | {"zoom": float("nan")}}, "`zoom` must be a finite number"),
        ({"view": VIEW | {"zoom": 0}}, "`zoom` must be 0.0001"),
        ({"view": VIEW | {"x": 1.5}}, "`x` must be a whole number"),
        ({"view": VIEW | {"height": 10**9}}, "`height` must be 1 to 8192"),
        ({"view": VIEW | {"height": 8192, "width": 8192}}, "`height x width` must be"),
        ({"view": VIEW | {"depth": 1}}, "View has no field 'depth'"),
        ({"view": {"zoom": 1, "x": 0, "y": 0, "height": 3}}, "View needs the field 'width'"),
        ({"view": VIEW | {"zoom": 1e5}}, "at most 65536 a side"),
        ({"settings": {"samples": 5}}, "`samples` must be one of"),
        ({"settings": {"coverage": "hard"}}, "`coverage` must be one of"),
        ({"settings": {"soft_width": 0.0}}, "`soft_width` must be"),
        ({"settings": {"pixel_filter": ["nearest"]}}, "`pixel_filter` must be a string"),
        ({"settings": {"anisotropy": 17}}, "`anisotropy` must be"),
        ({"kind": "inspect"}, "`column` must be a whole number"),
        ({"kind": "inspect", "column": 96, "row": 0}, "`column` must be 0 to 95"),
        ({"kind": "gradients", "target": 0}, "is made of triangles"),
        ({"kind": "edges", "subject": 1}, "is an image"),
    ],
)
def test_a_wrong_request_is_answered_with_one_line(fields, told):
    kind = fields.get("kind", "picture")
    replies = ask(small_session(), **({"kind": kind} | fields))
    assert [reply.header["kind"] for reply in replies] == ["error"]
    assert told in replies[0].header["message"]
    assert "\n" not in replies[0].header["message"]
    assert replies[0].header["request"] == kind
    assert replies[0].header["id"] == 7


@pytest.mark.parametrize("kind", [["picture"], {"a": 1}, None, True])
def test_a_kind_of_another_type_is_refused(kind, caplog):
    (reply,) = small_session().answer({"kind": kind, "id": 7})
    assert reply.header["kind"] == "error" and reply.header["id"] == 7
    assert "no request of kind" in reply.header["message"]
    assert caplog.records == []


def test_replies_do_not_repeat_nested_values():
    nested: list = []
    for _ in range(900):
        nested = [nested]
    (reply,) = ask(small_session(), "subjects", id=nested, slot={"a": nested})
    assert reply.header["id"] is None and reply.header["slot"] is None
    (frame,) = frames_of(reply)
    assert len(frame) > 20


@pytest.mark.parametrize("is_debugging", [False, True])
def test_tracebacks_are_logged_when_they_are_wanted(monkeypatch, caplog, is_debugging):
    monkeypatch.setenv("SOFTRAS2D_DEBUG", str(int(is_debugging)))
    session = small_session()

    def fail(*arguments, **keywords):
        raise TypeError("a mistake\nof two lines")

    monkeypatch.setattr(session._artist, "draw", fail)
    (reply,) = ask(session, "picture")
    assert reply.header["message"] == "unexpected TypeError: a mistake of two lines"
    (record,) = caplog.records
    assert "\n" not in record.getMessage()
    assert bool(record.exc_info) == is_debugging


def test_missing_memory_is_told_in_one_line(monkeypatch, caplog):
    session = small_session()

    def fail(*arguments, **keywords):
        raise RuntimeError("RESOURCE_EXHAUSTED: Out of memory\nallocating 8 GiB")

    monkeypatch.setattr(session._artist, "draw", fail)
    (reply,) = ask(session, "picture")
    assert reply.header["message"] == "RESOURCE_EXHAUSTED: Out of memory allocating 8 GiB"
    assert caplog.records == []


def test_missing_fields_have_defaults_and_whole_floats_are_integers():
    assert read_fields(Settings, {}) == Settings()
    view = read_fields(View, {"zoom": 1, "x": 2.0, "y": 0, "height": 3, "width": 4})
    assert view == View(1.0, 2, 0, 3, 4)
    assert isinstance(view.zoom, float) and isinstance(view.x, int)


def test_sizes_are_rounded_to_whole_pixels():
    assert enlarged_size(300, 200, 1.501) == (450, 300)
    assert enlarged_size(300, 200, 1e-4) == (1, 1)


def test_widths_of_one_class_share_a_plan():
    assert Settings(coverage="soft", soft_width=1.1).planned_width() == 2
    narrow, wide = (Settings(coverage="soft", soft_width=width) for width in (1.1, 2.0))
    assert narrow.without_arrays() == wide.without_arrays()
    assert narrow.without_arrays() != Settings(coverage="soft", soft_width=2.1).without_arrays()


def test_a_frame_holds_header_and_bytes():
    payload = np.arange(6, dtype=np.uint8).data
    (frame,) = frames_of(
        Reply({"kind": "x", "psnr": float("inf"), "list": [float("nan")]}, payload)
    )
    length = int.from_bytes(frame[:4], "little")
    assert json.loads(frame[4 : 4 + length]) == {"kind": "x", "psnr": None, "list": [None]}
    assert frame[4 + length :] == bytes(range(6))


@pytest.mark.parametrize("height", [3, 512, 700])
def test_the_parts_of_a_picture_are_its_pixels(height):
    pixels = np.random.default_rng(0).integers(0, 256, (height, 512, 4), np.uint8)
    pixels[: height // 2] = 7
    fields = {"kind": "picture", "id": 1, "slot": "a", "height": height, "width": 512}
    frames = frames_of(Reply(fields | {"plan": "a plan"}, pixels.reshape(-1).data))
    parts, last, first_pixel = [], False, 0
    for frame in frames:
        length = int.from_bytes(frame[:4], "little")
        header = json.loads(frame[4 : 4 + length])
        assert not last and header.items() >= fields.items()
        assert header["first_pixel"] == first_pixel
        parts.append(unpacked(header, frame[4 + length :]))
        first_pixel += len(parts[-1]) // 4
        last = header["is_last"]
        assert last == ("plan" in header)
    assert last and b"".join(parts) == pixels.tobytes()
    assert len(parts) == -(-height // 512)
