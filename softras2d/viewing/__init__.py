"""The interactive viewer, as a local web page and as a notebook widget.

A subject is a drawing or an image that the viewer shows (`subject.py`). A `Session` answers
requests for pictures, pixels and overlays of its subjects, and knows nothing of the web. The server
of the web page and the notebook widget carry the same messages to the same JavaScript module,
`static/viewer.js`.

When the view changes, the page sends its `View`: zoom, offset, and size of the canvas (`view.py`).
`Session.picture` asks the subject for its scene at that zoom (`subject.py`): an SVG file is read
again for the enlarged canvas, and a scene in memory is scaled. `Artist` (`draw.py`) draws the part
of the scene that the canvas shows, with the plan of the nearest octave of zoom (`plans.py`). Until
the picture arrives, `static/viewer.js` shows the last one, moved and scaled.

Requests are answered in a separate thread (`worker.py`), and large programs are compiled in another
(`background.py`), so that a slow render does not delay the page. A newer request of a page replaces
its older requests of the same kind and slot (`session.py`).

Each subject has a `version`, which changes whenever its contents do. The server and the widget
compare the versions periodically, and send a message of kind "changed". The page then asks for the
versions. It requests a picture again if the fields of the request or the version of the subject
differ from those of its last request.
"""
