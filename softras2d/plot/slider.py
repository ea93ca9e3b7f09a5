"""Shows an image that depends on a value: as a film strip, and with a slider in a notebook."""

# pyright: reportMissingImports=false

import io
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

from .library import AnyFigure, import_pyplot
from .picture import show
from .strip import film_strip


def explore(
    draw: Callable[[Any], Any], values: Sequence[Any], *, name: str, static: Sequence[Any]
) -> AnyFigure:
    """Show `draw(value)`, an image `[height, width, 1, 3 or 4]`, for a value called `name`.

    A film strip shows the values in `static`. Where ipywidgets is installed and someone looks on
    (Jupyter, VS Code, Colab), a slider over `values` draws on demand too; a notebook that is run
    without anyone, as nbconvert runs it, keeps the strip alone. Returns the strip's figure. Raises
    `ValueError`, one line, for no `values`, no `static`, and what `draw` returns if it is no image.
    """
    if not len(values) or not len(static):
        raise ValueError("`values` and `static` must hold at least one value each.")
    strip = film_strip(map(draw, static), titles=[_titled(name, value) for value in static])
    if _is_watched():
        _display_slider(draw, values, name)
    return strip


def _titled(name: str, value: Any) -> str:
    return f"{name}: {value:g}" if isinstance(value, float) else f"{name}: {value}"


def _is_watched() -> bool:
    """Whether this is a notebook that a front end shows, rather than one that nbconvert runs."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython else None
    if shell is None or not hasattr(shell, "kernel"):
        return False
    # Jupyter's server names its kernels' sessions, VS Code puts a name into them.
    return (
        "JPY_SESSION_NAME" in os.environ
        or "__vsc_ipynb_file__" in shell.user_ns
        or "google.colab" in sys.modules
    )


def _display_slider(draw: Callable[[Any], Any], values: Sequence[Any], name: str) -> None:
    try:
        import ipywidgets  # noqa: F401
        from IPython.display import display
    except ImportError:
        return
    display(slider(draw, values, name))


def slider(draw: Callable[[Any], Any], values: Sequence[Any], name: str) -> Any:
    """A widget: a slider over `values` and the image that `draw` makes of the chosen one."""
    import ipywidgets

    options = [
        (f"{value:g}" if isinstance(value, float) else str(value), value) for value in values
    ]
    chosen = ipywidgets.SelectionSlider(
        options=options,
        description=name,
        continuous_update=False,
        style={"description_width": "initial"},
        layout={"width": "480px"},
    )
    picture = ipywidgets.Image(format="png")

    def redraw(_change: Any = None) -> None:
        picture.value = _png(draw(chosen.value))

    chosen.observe(redraw, names="value")
    redraw()
    return ipywidgets.VBox([chosen, picture])


def _png(image: Any) -> bytes:
    """The image as `show` draws it."""
    pyplot = import_pyplot()
    with pyplot.ioff():
        figure: Any = show(image).figure
        file = io.BytesIO()
        figure.savefig(file, format="png")
        pyplot.close(figure)
    return file.getvalue()
