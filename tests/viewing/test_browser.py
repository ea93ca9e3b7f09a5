"""A file that only this user can read sends the browser to the secret address of the viewer."""

import html
import re
import stat
import webbrowser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from softras2d.viewing.browser import opened_page

URL = "http://127.0.0.1:8000/secret&token/"


def test_the_address_is_in_a_private_file_alone(monkeypatch):
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    with opened_page(URL):
        (address,) = opened
        assert address.startswith("file:") and "secret" not in address
        path = Path(unquote(urlsplit(address).path))
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
        target = re.search(r"url=([^\"]*)", path.read_text())
        assert target is not None and html.unescape(target.group(1)) == URL
    assert not path.parent.exists()


def test_the_file_is_removed_when_the_viewer_fails(monkeypatch):
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    with pytest.raises(KeyboardInterrupt), opened_page(URL):
        raise KeyboardInterrupt
    assert not Path(urlsplit(opened[0]).path).exists()
