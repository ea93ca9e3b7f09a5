"""The interactive viewer, as a local web page and as a notebook widget.

`Session` answers requests for pictures, pixels and overlays, and knows nothing of the web. The
server and the widget carry the same messages to the same JavaScript module, `static/viewer.js`.
"""
