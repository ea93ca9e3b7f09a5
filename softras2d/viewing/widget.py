"""The viewer as a notebook widget. Imports anywidget."""

# pyright: reportMissingImports=false

import base64
from pathlib import Path
from typing import Any, ClassVar

import anywidget
import traitlets
from IPython.display import display

from .frames import finite
from .session import URGENCY, Reply, Session, scalar
from .still import still_png
from .worker import Worker

_STATIC = Path(__file__).parent / "static"


class ViewerWidget(anywidget.AnyWidget):
    """Shows the subjects of a session. Made by `softras2d.view`.

    Pictures are drawn in a thread, so that cells can run meanwhile. `still` is a picture for pages
    without a running kernel, which a saved notebook holds.
    """

    _esm: ClassVar[Path] = _STATIC / "viewer.js"
    _css: ClassVar[Path] = _STATIC / "viewer.css"

    height = traitlets.Int(480).tag(sync=True)
    still = traitlets.Unicode("").tag(sync=True)

    def __init__(self, session: Session, height: int):
        self._session = session
        self._png = base64.b64encode(still_png(session, height)).decode()
        self._worker = Worker()
        super().__init__(height=height, still=f"data:image/png;base64,{self._png}")
        self.on_msg(self._receive)

    def close(self) -> None:
        """Close the widget in every output that shows it, and end its thread."""
        self._worker.close()
        super().close()

    def _receive(self, widget: Any, request: Any, buffers: Any) -> None:
        """Pass a request on to the worker."""
        if not isinstance(request, dict):
            return
        # Each output that shows the widget has a view of its own.
        owner = str(request.pop("owner", ""))
        if request.get("kind") == "closed":
            self._worker.forget(owner)
            return
        kind, slot = (str(scalar(request.get(name))) for name in ("kind", "slot"))

        def deliver(reply: Reply) -> None:
            buffers = [reply.payload] if len(reply.payload) else None
            self.send({**finite(reply.header), "owner": owner}, buffers=buffers)

        self._worker.submit(
            owner, (kind, slot), URGENCY.get(kind, 0), self._session.answer(request), deliver
        )

    def _repr_mimebundle_(self, **keywords: Any) -> Any:
        """The widget, and a picture for front ends that show no widgets."""
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
