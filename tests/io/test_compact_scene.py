"""Compact binary files of scenes are read back up to rounding, or refused in one line."""

import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import softras2d as sr
from softras2d.io.compact_scene import _decode_integers, _encode_integers


def soup(corners: int = 1, channels: int = 3) -> sr.Scene:
    rng = np.random.default_rng(0)
    colors = rng.random((20, corners, channels))
    return sr.Scene.from_soup(rng.uniform(-9, 60, (20, 3, 2)), colors, background=[0.2, 0.4, 0.6])


def mesh() -> sr.Scene:
    positions = np.array([[0, 0], [40, 0], [0, 30], [40, 30], [17.3, 12.9]])
    triangles = [[0, 1, 4], [1, 3, 4], [3, 2, 4], [2, 0, 4]]
    colors = np.random.default_rng(0).random((5, 3))
    return sr.Scene.from_mesh(positions, triangles, vertex_colors=colors, background=[0, 0, 0, 0])


@pytest.mark.parametrize("steps", [1, 8, 1000])
@pytest.mark.parametrize("scene", [soup(), soup(3, 4), mesh(), sr.Scene.from_soup([], [])])
def test_what_is_read_is_the_rounded_scene(tmp_path, scene, steps):
    path = tmp_path / "a.s2d"
    size = sr.write_compact(path, scene, height=30, width=40, steps_per_pixel=steps)
    assert size == path.stat().st_size
    again, height, width = sr.read_compact(path)
    assert (height, width) == (30, 40)
    np.testing.assert_allclose(again.positions, scene.positions, atol=0.5001 / steps)
    np.testing.assert_array_equal(again.triangles, scene.triangles)
    np.testing.assert_allclose(again.colors, scene.colors, atol=0.5001 / 255)
    np.testing.assert_allclose(again.background, scene.background, atol=0.5001 / 255)
    # Writing the result again rounds nothing further.
    sr.write_compact(tmp_path / "b.s2d", again, height=30, width=40, steps_per_pixel=steps)
    assert (tmp_path / "b.s2d").read_bytes() == path.read_bytes()


@given(st.lists(st.integers(-(2**30) + 1, 2**30 - 1)))
def test_integers_survive_their_planes(integers):
    array = np.array(integers, np.int64)
    np.testing.assert_array_equal(_decode_integers(_encode_integers(array)), array)


@pytest.mark.parametrize("cut", [0, 5, 20, 40, -1])
def test_files_cut_short_are_refused_in_one_line(tmp_path, cut):
    path = tmp_path / "a.s2d"
    sr.write_compact(path, soup(), height=30, width=40)
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(ValueError, match="not a complete compact scene: ") as caught:
        sr.read_compact(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


def test_hostile_files_are_refused(tmp_path):
    path = tmp_path / "a.s2d"
    sr.write_compact(path, mesh(), height=30, width=40)
    data = bytearray(path.read_bytes())
    # The files claim too many triangles, unpack to too many bytes, name a missing vertex, or go on.
    for wrong in (
        data[:20] + struct.pack("<I", 2**31) + data[24:],
        data[:32] + zlib.compress(bytes(10**7)),
        data[:32] + zlib.compress(bytes(40) + b"\x7f" * 48 + bytes(64)),
        data + b"\0",
    ):
        path.write_bytes(wrong)
        with pytest.raises(ValueError, match="not a complete compact scene"):
            sr.read_compact(path)
    with pytest.raises(ValueError, match="no such file"):
        sr.read_compact(tmp_path / "none.s2d")


def test_what_cannot_be_stored_is_refused(tmp_path, monkeypatch):
    path, scene = tmp_path / "a.s2d", soup()
    deep = replace(scene, depth=scene.positions[:, 0])
    with pytest.raises(ValueError, match="has no `depth`"):
        sr.write_compact(path, deep, height=30, width=40)
    for change, message in (
        ({"height": 0}, "`height` must be an integer in 1..4294967295; got 0"),
        ({"width": -4}, "`width` must be an integer in 1..4294967295; got -4"),
        ({"width": 2**32}, "`width` must be an integer in 1..4294967295; got 4294967296"),
        ({"steps_per_pixel": 0}, "`steps_per_pixel` must be an integer in 1..1024; got 0"),
        ({"steps_per_pixel": 1025}, "`steps_per_pixel` must be an integer in 1..1024; got 1025"),
    ):
        with pytest.raises(ValueError, match=message):
            sr.write_compact(path, scene, **{"height": 30, "width": 40, **change})
    far = sr.Scene.from_soup([[[0, 0], [1e9, 0], [0, 1]]], [[0, 0, 0]])
    with pytest.raises(ValueError, match="within 2\\^30 steps"):
        sr.write_compact(path, far, height=30, width=40)
    monkeypatch.setattr("softras2d.io.compact_scene._MAX_COUNT", 3)
    with pytest.raises(ValueError, match="at most 3 vertices; got"):
        sr.write_compact(path, scene, height=30, width=40)
    assert not path.exists()
