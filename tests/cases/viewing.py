"""A small scene, image and session for tests of the viewer, and requests to the session."""

from typing import Any

import numpy as np

import softras2d as sr
from softras2d.viewing.image import Image
from softras2d.viewing.packed_pixels import BLOCK
from softras2d.viewing.scene_in_memory import SceneInMemory
from softras2d.viewing.session import Reply, Session

HEIGHT, WIDTH = 48, 64
"""Size of the scene's canvas at zoom 1, in pixels."""

VIEW = {"zoom": 1.5, "x": 10, "y": 5, "height": 64, "width": 96}


def small_scene(channels: int = 3) -> sr.Scene:
    """Twenty flat triangles, some of which share samples, over a grey background."""
    rng = np.random.default_rng(0)
    corners = rng.uniform(0, 1, (20, 3, 2)) * [WIDTH, HEIGHT]
    colors = rng.uniform(0, 1, (20, channels))
    return sr.Scene.from_soup(corners.astype(np.float32), colors, background=[0.8, 0.8, 0.8])


def small_image() -> np.ndarray:
    """A random image of the size of the scene's canvas."""
    return np.random.default_rng(1).uniform(0, 1, (HEIGHT, WIDTH, 3)).astype(np.float32)


def small_session() -> Session:
    """A session that shows the small scene and the small image."""
    return Session(
        [
            SceneInMemory("scene", small_scene(), HEIGHT, WIDTH),
            Image("image", small_image),
        ]
    )


def ask(session: Session, kind: str, **fields: Any) -> list[Reply]:
    """The replies to a request for `VIEW` with 4 samples, unless `fields` say otherwise."""
    request = {"kind": kind, "id": 7, "view": VIEW, "settings": {"samples": 4}} | fields
    return list(session.answer(request))


def pixels_of(reply: Reply) -> np.ndarray:
    """The picture of a reply, `[height, width, 4]` bytes."""
    shape = (reply.header["height"], reply.header["width"], 4)
    return np.frombuffer(reply.payload, np.uint8).reshape(shape)


def bytes_of(scene: sr.Scene, view: dict[str, Any], coverage: Any, filter: Any = None) -> Any:
    """The RGB bytes of `render` for a view of an already enlarged scene, by a plan for it alone."""
    plan = sr.plan(
        scene,
        height=view["height"],
        width=view["width"],
        origin=(view["x"], view["y"]),
        coverage=coverage,
        filter=filter,
    )
    image = np.asarray(sr.render(scene, plan))
    return np.floor(np.clip(image, 0, 1) * np.float32(255) + np.float32(0.5)).astype(np.uint8)


def unpacked(header: dict[str, Any], payload: bytes) -> bytes:
    """The payload of a message with its pixels unpacked.

    Pixels may be packed block by block: a block of one colour is sent as one pixel.
    """
    if "blocks" not in header:
        return payload
    blocks, colors = header["blocks"], header["colors"]
    bit_bytes = 4 * -(-blocks // 32)
    bits = np.unpackbits(np.frombuffer(payload[:bit_bytes], np.uint8), bitorder="little")
    words = np.frombuffer(payload[bit_bytes:], np.uint32)
    at_color, at_other, pixels = 0, colors, []
    for has_one_color in bits[:blocks]:
        if has_one_color:
            pixels.append(np.full(BLOCK, words[at_color]))
            at_color += 1
        else:
            pixels.append(words[at_other : at_other + BLOCK])
            at_other += BLOCK
    assert at_color == colors
    return np.concatenate([*pixels, words[at_other:]]).astype(np.uint32).tobytes()
