"""Opens a page with a secret address in the browser.

Every user of a machine can read the command lines of its processes. The command line of the browser
therefore does not contain the address of the page. It names a file that only this user can read,
and that file sends the browser on to the address.

**Source:** Jupyter Server does the same (`ServerApp.use_redirect_file`).
"""

import html
import os
import tempfile
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_PAGE = """\
<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="referrer" content="no-referrer">
<meta http-equiv="refresh" content="0; url={url}">
<title>softras2d</title>
</head>
<body><a href="{url}">Open the viewer</a></body>
</html>
"""


@contextmanager
def opened_page(url: str) -> Iterator[None]:
    """Open the page at `url` in the browser, as a context manager.

    The browser is given a temporary file that redirects it to `url`. The file exists until the body
    of the `with` statement has ended.
    """
    with tempfile.TemporaryDirectory(prefix="softras2d-") as folder:
        path = Path(folder) / "viewer.html"
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            file.write(_PAGE.format(url=html.escape(url)))
        webbrowser.open(path.as_uri())
        yield
