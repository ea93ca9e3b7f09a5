"""The function `explore`, which shows how an image depends on a value, if need be with a slider."""

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
    """Show how an image depends on a value, side by side and, in a notebook, with a slider.

    - `draw`: function from a value to an image, floats `[height, width, channels]` in sRGB, 0..1,
      of 1, 3 or 4 channels.
    - `values`: the values that the slider offers. An image is drawn when its value is chosen.
    - `name`: name of the value, for titles and for the slider.
    - `static`: the values whose images are drawn at once, side by side in one figure.

    The slider appears if ipywidgets is installed and a front end shows the notebook (Jupyter, VS
    Code, Colab), but not if the notebook is executed without one, for example by nbconvert. Returns
    the figure of `static`. Raises `ValueError`, with a message of one line, for no `values`, no
    `static`, or if `draw` returns something that is not an image.
    """
    if not len(values) or not len(static):
        raise ValueError("`values` and `static` must hold at least one value each.")
    titles = [f"{name}: {_value_text(value)}" for value in static]
    figure = film_strip(map(draw, static), titles=titles)
    if _has_front_end():
        _display_slider(draw, values, name)
    return figure


def _value_text(value: Any) -> str:
    """Text of a value for titles: a float with at most six digits, else `str(value)`."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def _has_front_end() -> bool:
    """Whether this code runs in a notebook that a front end shows, rather than under nbconvert."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython else None
    if shell is None or not hasattr(shell, "kernel"):
        return False
    # Jupyter's server sets this environment variable for its kernels; VS Code defines this name in
    # the kernel.
    return (
        "JPY_SESSION_NAME" in os.environ
        or "__vsc_ipynb_file__" in shell.user_ns
        or "google.colab" in sys.modules
    )


def _display_slider(draw: Callable[[Any], Any], values: Sequence[Any], name: str) -> None:
    """Display the widget of `slider`, unless ipywidgets or IPython is missing."""
    try:
        import ipywidgets  # noqa: F401
        from IPython.display import display
    except ImportError:
        return
    display(slider(draw, values, name))


def slider(draw: Callable[[Any], Any], values: Sequence[Any], name: str) -> Any:
    """Make a widget: a slider over `values`, and below it the image `draw(value)` of its value.

    `name`: label of the slider.
    """
    import ipywidgets

    options = [(_value_text(value), value) for value in values]
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
    """Encode an image, as `show` draws it, as a PNG file."""
    pyplot = import_pyplot()
    with pyplot.ioff():
        figure: Any = show(image).figure
        file = io.BytesIO()
        figure.savefig(file, format="png")
        pyplot.close(figure)
    return file.getvalue()
