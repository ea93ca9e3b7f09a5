"""Draws the still picture of a session, for notebook pages without a running kernel.

A session answers requests about subjects, which are the drawings and images that a viewer shows.
"""

from .draw import Artist
from .png import png_of
from .session import Session
from .settings import Settings
from .view import View

_ASPECT = 4 / 3
"""Maximum width of the picture, as a multiple of its maximum height."""


def still_png(session: Session, height: int) -> bytes:
    """Draw the first subject of a session as a PNG file.

    The picture shows the complete subject, with default settings. It is as large as it can be, but
    at most `height` pixels high, and at most 4/3 times `height` pixels wide.
    """
    subject = session.subjects[0]
    rows, columns = subject.size()
    zoom = min(height / rows, _ASPECT * height / columns)
    view = View(zoom, 0, 0, max(1, round(rows * zoom)), max(1, round(columns * zoom)))
    if subject.is_image:
        return png_of(subject.pixels(view))
    return png_of(Artist().draw(subject.scene_at(zoom), view, Settings()).rgba)
