"""Answers the requests of a page: pictures, pixels, overlays and costs. Knows nothing of the web.

A request is a dictionary that a page sends as JSON. It has a `kind`, an `id` and a `slot`, which
the replies repeat (kinds "error" and "reference" aside), and fields that depend on the kind. All
kinds but "subjects" have the fields `subject`, the index of a subject, `view` and `settings`, which
are objects with the fields of `View` and `Settings`. The slot tells the two pictures of a page
apart: "a" is the picture of the subject that the page shows, and "b" is the picture of the subject
with which it is compared. Other requests have other slots or none. A newer request of a page
replaces its older ones of the same kind and slot. A reply has a header, for JSON, and bytes.

A subject is a drawing or an image that the viewer shows (`subject.py`). A view is the part of it
that a canvas shows, with its zoom (`view.py`).
"""

import dataclasses
import logging
import os
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..rendering.cost import price_effects
from .draw import Artist
from .inspector import inspect_pixel, reference_value
from .message_fields import check_range, read_fields, read_value
from .overlays import position_gradients, tile_lengths, triangle_edges
from .png import png_of
from .settings import Settings
from .subject import Subject
from .view import View

_LOGGER = logging.getLogger(__name__)

_COST_REPEATS = 3
"""Number of timed renders with and without each effect; the median of their times is shown."""


class Reply(NamedTuple):
    """A reply to a request: a header for JSON, and the bytes `payload`."""

    header: dict[str, Any]
    payload: Any = b""


class Session:
    """Answers requests about the subjects of a viewer. One thread at a time may call `answer`.

    Raises `ValueError` if there are no subjects.
    """

    def __init__(self, subjects: Sequence[Subject]):
        if not subjects:
            raise ValueError("there is nothing to view: give at least one scene or image.")
        self.subjects = tuple(subjects)
        self._artist = Artist()
        self._subject_of_page: dict[Hashable, object] = {}

    def versions(self) -> list[int]:
        """The version of each subject, which changes with its contents."""
        return [subject.version for subject in self.subjects]

    @property
    def may_change(self) -> bool:
        """Whether some subject may change while it is shown."""
        return any(subject.may_change for subject in self.subjects)

    def is_compiling(self) -> bool:
        """Whether a plan for later views is being compiled in the background."""
        return self._artist.is_compiling()

    def close(self) -> None:
        """Wait for compilation in the background to end.

        The process must not exit while XLA compiles.
        """
        self._artist.close()

    def set_shown_subject(self, page: Hashable, number: object) -> None:
        """Record which subject a page shows, and tell each subject whether any page shows it.

        `page` is a key for the page, and `number` the index of the subject; None for a page that
        was closed. A number that is no index, as a page may send it, names no subject.
        """
        self._subject_of_page[page] = number
        if number is None:
            del self._subject_of_page[page]
        for subject_number, subject in enumerate(self.subjects):
            subject.watch(subject_number in self._subject_of_page.values())

    def answer(self, request: Mapping[str, Any]) -> Iterator[Reply]:
        """Answer a request; yields one reply or several, each when it has been computed.

        An error in a request or a file is answered by a reply of kind `"error"`, whose `message` is
        one line and whose `request` is the kind of the request. So is any other error, which is
        logged too.
        """
        request_fields = {name: scalar(request.get(name)) for name in ("kind", "id", "slot")}
        kind = request_fields["kind"]
        try:
            if kind not in _ANSWERS:
                raise ValueError(f"no request of kind {str(kind)[:40]!r}.")
            for reply in _ANSWERS[kind](self, request):
                yield reply._replace(header=request_fields | reply.header)
        except Exception as error:
            # A bug in one overlay must not end the viewer.
            message = _one_line(error)
            if not _is_expected(error):
                message = f"unexpected {type(error).__name__}: {message}"
                _LOGGER.error(
                    "a request of kind %r failed: %s", kind, message, exc_info=_is_debugging()
                )
            yield Reply(request_fields | {"kind": "error", "request": kind, "message": message})

    def subject_of(self, request: Mapping[str, Any], name: str = "subject") -> Subject:
        """The subject whose index is the field `name` of a request; without this field, the first.

        Raises `ValueError` for a value that is not the index of a subject.
        """
        number = read_value(name, int, request.get(name, 0))
        check_range(name, number, 0, len(self.subjects) - 1)
        return self.subjects[number]

    def describe(self, request: Mapping[str, Any]) -> Iterator[Reply]:
        """Reply with a list of the subjects, each as `_describe` describes it, in the header."""
        yield Reply({"subjects": [_describe(subject) for subject in self.subjects]})

    def picture(self, request: Mapping[str, Any]) -> Iterator[Reply]:
        """Draw a view; reply with straight RGBA of 8 bits per channel, row by row.

        The header has the size and the view of the picture, the version of the subject, the times
        to draw and to compile, the effects and a description of the plan, the notes of the subject,
        and the command that draws the same picture.
        """
        subject, view, settings = self._read(request)
        if subject.is_image:
            rgba = subject.pixels(view)
            header = {"milliseconds": 0, "compile_seconds": 0, "effects": [], "plan": "an image"}
        else:
            scene = subject.scene_at(view.zoom)
            drawn = self._artist.draw(scene, view, settings)
            self._artist.prepare_zoom(scene, view, settings)
            rgba = drawn.rgba
            header = {
                "milliseconds": 1e3 * drawn.seconds,
                "compile_seconds": drawn.compile_seconds,
                "effects": list(drawn.plan.effects),
                "plan": str(drawn.plan),
            }
        header |= {
            "height": view.height,
            "width": view.width,
            "view": dataclasses.asdict(view),
            "version": subject.version,
            "notes": list(subject.notes()),
            "command": subject.command(view, settings),
        }
        yield Reply(header, _bytes(rgba))

    def png(self, request: Mapping[str, Any]) -> Iterator[Reply]:
        """Draw a view; reply with a PNG file, and the name of the subject in the header."""
        (reply,) = self.picture(request)
        shape = (reply.header["height"], reply.header["width"], 4)
        rgba = np.frombuffer(reply.payload, np.uint8).reshape(shape)
        yield Reply({"name": self.subject_of(request).name}, png_of(rgba))

    def inspect(self, request: Mapping[str, Any]) -> Iterator[Reply]:
        """Inspect a pixel; reply with its values and samples, and then with its reference value.

        The request has the `column` and `row` of the pixel on the canvas. The first reply is a
        `PixelReport`: the facts are its header, and the samples its bytes. The second, of kind
        `"reference"`, has `column`, `row`, and the result of `reference_value`: `name`, `value`.
        """
        subject, view, settings = self._read(request)
        column, row = (read_value(name, int, request.get(name)) for name in ("column", "row"))
        check_range("column", column, 0, view.width - 1)
        check_range("row", row, 0, view.height - 1)
        scene = subject.scene_at(view.zoom)
        report = inspect_pixel(self._artist, scene, view, settings, column, row)
        yield Reply(report.facts, _bytes(report.samples))
        name, value = reference_value(self._artist, scene, view, settings, column, row)
        header = {"column": column, "row": row, "name": name, "value": value}
        yield Reply({"kind": "reference"} | header)

    def edges(self, request: Mapping[str, Any]) -> Iterator[Reply]:
        """Reply with the corners of the triangles in view, (x, y) in pixels as float32.

        The pixels are those of the canvas. The header has the number of triangles in the reply,
        which are at most `overlays.MOST_EDGES`.
        """
        subject, view, _ = self._read(request)
        corners = triangle_edges(subject.scene_at(view.zoom), view)
        yield Reply({"triangles": len(corners)}, _bytes(corners))

    def tiles(self, request: Mapping[str, Any]) -> Iterator[Reply]:
        """Reply with the number of triangles that each tile lists, as uint32, row by row.

        A render divides the canvas into tiles, and lists for each tile the triangles to draw in it.
        The header has the numbers of rows and columns of tiles, and the size of a tile in pixels;
        the maximum, mean and sum of the lengths of the lists; and the capacity of the plan for the
        sum.
        """
        subject, view, settings = self._read(request)
        scene = subject.scene_at(view.zoom)
        _, plan = self._artist.render(scene, view, settings)
        lengths, tiling = tile_lengths(scene, plan), plan.tiling
        header = {
            "rows": tiling.rows,
            "columns": tiling.columns,
            "tile_height": tiling.height,
            "tile_width": tiling.width,
            "max": int(lengths.max()),
            "mean": float(lengths.mean()),
            "pairs_listed": int(lengths.sum()),
            "pairs_capacity": plan.capacity_of(len(scene.triangles)).pairs,
        }
        yield Reply(header, _bytes(lengths.astype(np.uint32)))

    def gradients(self, request: Mapping[str, Any]) -> Iterator[Reply]:
        """Reply with the gradient of each vertex: rows of (x, y, d/dx, d/dy) as float32.

        The differentiated function is the mean squared difference to the image of the subject whose
        index is the field `target` of the request. Only some vertices have rows (see
        `position_gradients`); their number is in the header.
        """
        subject, view, settings = self._read(request)
        target = self.subject_of(request, "target")
        rows = position_gradients(
            self._artist, subject.scene_at(view.zoom), view, settings, target.pixels(view)
        )
        yield Reply({"vertices": len(rows)}, _bytes(rows))

    def costs(self, request: Mapping[str, Any]) -> Iterator[Reply]:
        """Measure the time of a render with and without each effect, in milliseconds.

        Yields a reply for the complete scene, whose `effect` is None, and then one for each effect.
        `milliseconds` is with the effect, `milliseconds_without` without it; both are equal in the
        first reply. `is_last` is true in the last one.
        """
        subject, view, settings = self._read(request)
        scene = subject.scene_at(view.zoom)
        _, plan = self._artist.render(scene, view, settings)
        # Without effects, the row of the complete scene is the last one too.
        last_effect = plan.effects[-1] if plan.effects else None
        for effect, with_effect, without_effect in price_effects(
            scene, plan, repeats=_COST_REPEATS
        ):
            yield Reply(
                {
                    "effect": effect,
                    "milliseconds": 1e3 * with_effect.seconds,
                    "milliseconds_without": 1e3 * without_effect.seconds,
                    "is_last": effect == last_effect,
                }
            )

    def _read(self, request: Mapping[str, Any]) -> tuple[Subject, View, Settings]:
        """Read the subject, the view and the settings that a request names.

        Settings that the request lacks get their defaults. Raises `ValueError` for a field that is
        not valid, and for a request without a view.
        """
        subject = self.subject_of(request)
        view = read_fields(View, request.get("view"))
        return subject, view, read_fields(Settings, request.get("settings", {}))


_ANSWERS: dict[str, Callable[[Session, Mapping[str, Any]], Iterator[Reply]]] = {
    "subjects": Session.describe,
    "picture": Session.picture,
    "png": Session.png,
    "inspect": Session.inspect,
    "edges": Session.edges,
    "tiles": Session.tiles,
    "gradients": Session.gradients,
    "costs": Session.costs,
}
"""The method that answers each kind of request. The most urgent kinds come first."""

RANKS = {kind: rank for rank, kind in enumerate(_ANSWERS)}
"""Rank of each kind of request, from 0.

Of the waiting requests, the one of least rank is answered first.
"""


def scalar(value: Any) -> str | int | float | None:
    """Return the value if it is a string, a number or a boolean; otherwise None.

    Replies repeat fields of a request. They never repeat lists or objects, which may be nested
    deeply.
    """
    return value if isinstance(value, str | int | float) else None


def _is_expected(error: Exception) -> bool:
    """Whether an error is about the request, a file or the machine, rather than a bug."""
    is_out_of_memory = "RESOURCE_EXHAUSTED" in str(error)
    return is_out_of_memory or isinstance(error, ValueError | OSError | MemoryError)


def _one_line(error: Exception) -> str:
    """The message of an error on one line, cut to 300 characters; its type if it has no message."""
    return " ".join(str(error).split())[:300] or type(error).__name__


def _is_debugging() -> bool:
    """Whether tracebacks are wanted, as the environment variable SOFTRAS2D_DEBUG says.

    They are if it is set to anything but 0 or an empty string.
    """
    return os.environ.get("SOFTRAS2D_DEBUG", "") not in ("", "0")


def _bytes(array: np.ndarray) -> memoryview:
    """The bytes of an array, row by row."""
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8).data


def _describe(subject: Subject) -> dict[str, Any]:
    """Describe a subject for JSON: name, version, size at zoom 1, and the progress of a fit.

    It also says whether the subject is an image. If the size cannot be read, it is 1 x 1, and
    `error` is the message. The field `fit`, if a fit made the subject, has `is_running`, and
    `history` with a list of steps, seconds, PSNR in dB and triangles in use for each record whose
    PSNR is finite.
    """
    header: dict[str, Any] = {
        "name": subject.name,
        "version": subject.version,
        "is_image": subject.is_image,
    }
    try:
        header["height"], header["width"] = subject.size()
    except Exception as error:
        # A fault in one file must not hide the others.
        header |= {"height": 1, "width": 1, "error": _one_line(error)}
    fit = subject.fit_state()
    if fit is not None:
        header["fit"] = {
            "is_running": fit.is_running,
            "history": [
                [record.steps, record.seconds, record.psnr, record.active]
                for record in fit.history
                # JSON has no infinity.
                if np.isfinite(record.psnr)
            ],
        }
    return header
