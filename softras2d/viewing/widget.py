"""Shows the viewer as a notebook widget. Imports anywidget.

An output is the place below a notebook cell that shows a widget. Several outputs may show one
widget. Each sends requests, which a `Session` answers with replies (`session.py`).
"""

# pyright: reportMissingImports=false

import base64
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import anywidget
import traitlets
from IPython.display import display

from .frames import finite, with_packed_picture
from .session import RANKS, Reply, Session, scalar
from .shared_threads import shared_watcher, shared_worker
from .still import still_png

_STATIC = Path(__file__).parent / "static"


class _Output(NamedTuple):
    """An output of a notebook cell that shows a widget.

    - `widget`: identifies the widget in this process.
    - `name`: identifies the output among the outputs that show the widget.
    """

    widget: int
    name: str


class ViewerWidget(anywidget.AnyWidget):
    """A notebook widget that shows the subjects of a session; `softras2d.view` makes it.

    Pictures are drawn in a separate thread, so that cells can run meanwhile. While an output shows
    the widget, the files of its subjects are watched for changes.

    - `height`: height of the widget on the screen, in pixels.
    - `still`: a picture, as a data URL, for pages without a running kernel. A saved notebook
      contains it.
    """

    _esm: ClassVar[Path] = _STATIC / "viewer.js"
    _css: ClassVar[Path] = _STATIC / "viewer.css"

    height = traitlets.Int(480).tag(sync=True)
    still = traitlets.Unicode("").tag(sync=True)

    def __init__(self, session: Session, height: int):
        self._session = session
        self._png = base64.b64encode(still_png(session, height)).decode()
        self._outputs: set[_Output] = set()
        super().__init__(height=height, still=f"data:image/png;base64,{self._png}")
        self.on_msg(self._receive)

    def close(self) -> None:
        """Close the widget in every output that shows it."""
        for output in tuple(self._outputs):
            self._forget(output)
        super().close()

    def _receive(self, widget: Any, request: Any, buffers: Any) -> None:
        """Pass a request of an output on to the worker.

        The front end calls this: `request` is the message, from which the field `owner`, the name
        of the output, is removed. Other arguments are not used. A message of kind "closed" says
        that the output was closed. A message that is not a dictionary is ignored.
        """
        if not isinstance(request, dict):
            return
        # The outputs that show this widget zoom and pan independently.
        output = _Output(id(self), str(request.pop("owner", "")))
        if request.get("kind") == "closed":
            self._forget(output)
            return
        self._outputs.add(output)
        if self._session.may_change:
            shared_watcher().watch(id(self), self._session.versions, self._tell_versions)
        kind, slot = (str(scalar(request.get(name))) for name in ("kind", "slot"))

        def deliver(reply: Reply) -> None:
            reply = with_packed_picture(reply)
            buffers = [reply.payload] if len(reply.payload) else None
            self.send({**finite(reply.header), "owner": output.name}, buffers=buffers)

        shared_worker().submit(
            output, (kind, slot), RANKS.get(kind, 0), self._session.answer(request), deliver
        )

    def _forget(self, output: "_Output") -> None:
        """Drop the requests of an output that was closed. Without outputs, stop watching files."""
        shared_worker().forget(output)
        self._outputs.discard(output)
        if not self._outputs and self._session.may_change:
            shared_watcher().forget(id(self))

    def _tell_versions(self, versions: list[int]) -> None:
        """Tell all outputs that the contents of a subject have changed, with the new versions."""
        self.send({"kind": "changed", "versions": versions})

    def _repr_mimebundle_(self, **keywords: Any) -> Any:
        """Data of the widget by media type, with a picture for front ends without widgets."""
        bundle = super()._repr_mimebundle_(**keywords)
        if bundle is not None:
            bundle[0].update({"image/png": self._png, "text/plain": "The viewer of softras2d."})
        return bundle

    def _ipython_display_(self) -> None:
        """Show the picture and the widget, which hides the picture when it runs.

        JupyterLab shows nothing but an error for a widget without a kernel, and ignores the picture
        that comes with it.
        """
        display({"image/png": self._png, "text/plain": ""}, raw=True)
        bundle = self._repr_mimebundle_()
        if bundle is not None:
            display(bundle[0], raw=True)
