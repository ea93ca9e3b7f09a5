"""Reads the image files to which a document refers, if allowed, and numbers them as textures."""

import base64
import binascii
import re
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from ...budget import Budget, BudgetError
from .document import MAX_BYTES

_SCHEME = re.compile(r"[a-zA-Z][a-zA-Z0-9+.-]++:|//|\\\\")
_DATA = re.compile(r"data:(image/[^;,]*+)?+(?:;(?!base64,)[^;,]*+)*+;base64,")


class Assets:
    """The images to which a document refers, in sRGB with straight alpha. Each is read once.

    - `folder`: folder of the document, to which names of files are relative; None to use `root`.
    - `root`: folder that must contain every file, after symbolic links are resolved; None to use
      `folder`. If both are None, no file is read, only `data:` URIs.
    - `alpha`: whether textures keep an alpha channel. An alpha channel that is 1 everywhere is
      always dropped.
    - `budget`: charged for the pixels that the header of each image claims; None for a new budget.
    - `textures`: the images that have been used as textures, `[height, width, 3 or 4]` each.
    """

    def __init__(
        self, folder: Path | None, root: Path | None, alpha: bool, budget: Budget | None = None
    ):
        self._budget = budget or Budget()
        self._alpha = alpha
        self._folder = folder or root
        self._root = root or folder
        self._declared: dict[str, Path] = {}
        self._indices: dict[Path | str, int] = {}
        self._pictures: dict[Path | str, np.ndarray] = {}
        self._unreadable: dict[str, str] = {}
        self.textures: list[np.ndarray] = []

    def declare(self, texid: str, filename: str) -> None:
        """Give the texture in the file `filename` the name `texid`. The file is not read yet.

        `filename` is not percent-encoded. A later declaration of the same name replaces it. Raises
        `ValueError` for a file that does not exist or may not be read.
        """
        self._declared[texid] = self._path(filename)

    def texture(self, texid: str) -> int:
        """Index in `textures` of the texture that `declare` has named `texid`.

        Its file is read, and appended to `textures`, at its first use. Raises `ValueError` if no
        texture has this name, or if its file cannot be read.
        """
        if texid not in self._declared:
            raise ValueError(f"no texture {texid!r} is declared before this element.")
        return self._index(self._declared[texid])

    def linked(self, href: str) -> int:
        """Index in `textures` of the image to which the `href` of an `image` element refers.

        `href` is a `data:` URI, or the percent-encoded name of a file. The image is read, and
        appended to `textures`, at its first use. Raises `ValueError` for an image that cannot be
        read.
        """
        return self._index(self._readable_key(href))

    def picture(self, href: str) -> np.ndarray:
        """The pixels `[height, width, 3 or 4]`, in sRGB, of the image to which an `href` refers.

        Unlike `linked`, this method does not append the image to `textures`, and it keeps an alpha
        channel in any case. Raises `ValueError` for an image that cannot be read.
        """
        return self._read(self._readable_key(href))

    def _readable_key(self, href: str) -> Path | str:
        """Key of a linked image in the caches, after the image has been read.

        Raises `ValueError` for an image that cannot be read. Such an image is not tried again:
        later calls raise the same message. A `BudgetError`, for images that are too large, is
        raised anew.
        """
        if href in self._unreadable:
            raise ValueError(self._unreadable[href])
        try:
            key = self._key(href)
            self._read(key)
        except BudgetError:
            raise
        except ValueError as error:
            self._unreadable[href] = str(error)
            raise
        return key

    def _key(self, href: str) -> Path | str:
        """Key of a linked image in the caches: the path of its file, or its `data:` URI unchanged.

        `href` is a `data:` URI, or the percent-encoded name of a file. Raises `ValueError` for a
        file that does not exist or may not be read.
        """
        if href.lstrip().startswith("data:"):
            return href
        return self._path(unquote(href.strip()))

    def _index(self, key: Path | str) -> int:
        """Index in `textures` of the image with this key, which is appended at its first use.

        `key` is a result of `_key`. An alpha channel is dropped if the constructor's `alpha` is
        false, or if it is 1 everywhere.
        """
        if key not in self._indices:
            picture = self._read(key)
            if picture.shape[-1] == 4 and (not self._alpha or (picture[..., 3] == 1).all()):
                picture = picture[..., :3]
            self._indices[key] = len(self.textures)
            self.textures.append(picture)
        return self._indices[key]

    def _read(self, key: Path | str) -> np.ndarray:
        """The pixels `[height, width, 3 or 4]`, in sRGB, of an image that is read at its first use.

        `key` is a result of `_key`. Raises `ValueError` for an image that cannot be decoded or is
        in a file of more than `MAX_BYTES`, and for pixels beyond the budget.
        """
        # Imported here, since scenes without images need no image library.
        from ...images import read_charged

        if key not in self._pictures:
            if isinstance(key, str):
                picture = read_charged(_embedded(key), "embedded image", self._charge)
            elif key.stat().st_size > MAX_BYTES:
                raise ValueError(f"{key}: larger than {MAX_BYTES >> 20} MB.")
            else:
                picture = read_charged(key, str(key), self._charge)
            self._pictures[key] = np.asarray(picture)
        return self._pictures[key]

    def _charge(self, pixels: int) -> None:
        """Charge the pixels of an image to the budget."""
        self._budget.charge("texels", pixels)

    def _path(self, name: str) -> Path:
        """The absolute path of the file `name`, which is relative to the folder of the document.

        Symbolic links are resolved. Raises `ValueError` for an empty name or a URL, if there is
        no folder, and unless the file exists and lies in the folder `root` of the constructor.
        """
        if not name:
            raise ValueError("the name of the file is empty.")
        if _SCHEME.match(name):
            raise ValueError(f"{name[:60]!r} is not a file beside the scene; nothing is fetched.")
        if self._folder is None or self._root is None:
            raise ValueError(
                f"{name!r} is not read: a text has no folder; give one by `assets` or --assets."
            )
        try:
            root = self._root.resolve()
            path = (self._folder / name).resolve()
            is_inside, exists = path.is_relative_to(root), path.is_file()
        except (OSError, RuntimeError, ValueError) as error:
            raise ValueError(f"{name[:60]!r} cannot be a file: {error}.") from None
        if not is_inside:
            raise ValueError(f"{name!r} lies outside the folder {root}; see `assets`.")
        if not exists:
            raise ValueError(f"{name!r}: there is no such file ({path}).")
        return path


def _embedded(uri: str) -> bytes:
    """Decode a `data:` URI that is an image in base64; returns the bytes of the image file.

    Raises `ValueError` for text that is not base64, and for media other than raster images. A URI
    without a media type is accepted.
    """
    uri = uri.lstrip()
    header = _DATA.match(uri)
    if header is None:
        raise ValueError("data: only base64 images are read.")
    if (header[1] or "").startswith("image/svg"):
        raise ValueError("data: an SVG inside an SVG is not read.")
    try:
        text = "".join(unquote(uri[header.end() :]).split())
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        raise ValueError("data: not valid base64.") from None
