"""The interactive viewer, as a local web page and as a notebook widget.

`Session` answers requests for pictures, pixels and overlays, and knows nothing of the web. The
server and the widget carry the same messages to the same JavaScript module, `static/viewer.js`.

Requests are answered in a thread of their own (`worker.py`), and large programs compile in another
(`background.py`), so that a slow render does not delay the page. A newer request replaces older
ones of the same kind.

Each subject has a `version`, which changes whenever its contents do (`subject.py`). The server and
the widget compare the versions periodically, and send a message of kind "changed". The page then
asks for the versions, and requests a picture again if its fields or its version differ from those
of the last request.
"""
