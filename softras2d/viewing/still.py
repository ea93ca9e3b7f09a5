"""The still picture of a session, for pages on which nothing can be drawn."""

from .draw import Artist
from .png import png_of
from .session import Session
from .settings import Settings
from .view import View

_ASPECT = 4 / 3
"""Greatest width of the picture, relative to its height."""


def still_png(session: Session, height: int) -> bytes:
    """A PNG file of the first subject, at most `height` pixels high."""
    subject = session.subjects[0]
    rows, columns = subject.size()
    zoom = min(height / rows, _ASPECT * height / columns)
    view = View(zoom, 0, 0, max(1, round(rows * zoom)), max(1, round(columns * zoom)))
    if subject.is_image:
        return png_of(subject.pixels(view))
    return png_of(Artist().draw(subject.scene_at(zoom), view, Settings()).rgba)
