"""The pixel inspector and the overlays agree with the oracle and with `jax.grad`."""

from typing import Any

import jax
import numpy as np
import pytest

import softras2d as sr
from softras2d.io.pixel_values import to_bytes
from softras2d.viewing.scene_in_memory import SceneInMemory, enlarge
from softras2d.viewing.session import Reply, Session

from ..cases.viewing import (
    HEIGHT,
    VIEW,
    WIDTH,
    ask,
    bytes_of,
    small_image,
    small_scene,
    small_session,
)
from ..oracles.coverage import Canvas, footprints

pytestmark = pytest.mark.slow

PIXELS = [(40, 30), (10, 50), (63, 31), (20, 20), (0, 0), (95, 63)]
"""Column and row of the inspected pixels."""


@pytest.fixture(scope="module")
def session() -> Session:
    return small_session()


def inspect(session: Session, column: int, row: int, **fields: Any) -> tuple[Reply, Reply]:
    report, reference = ask(session, "inspect", column=column, row=row, **fields)
    return report, reference


def covering(canvas: Canvas, column: int, row: int) -> dict[int, set[int]]:
    """The samples of a pixel that each triangle covers, by the oracle; later triangles first."""
    scene = enlarge(small_scene(), 1.5, 1.5)
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)]
    samples = {}
    for triangle, footprint in enumerate(footprints(corners, canvas)):
        inside = np.zeros((canvas.height * canvas.rate, canvas.width * canvas.rate), bool)
        inside[footprint.rows, footprint.columns] = footprint.inside
        rate = canvas.rate
        of_pixel = inside[row * rate : (row + 1) * rate, column * rate : (column + 1) * rate]
        if of_pixel.any():
            samples[triangle] = set(np.flatnonzero(of_pixel).tolist())
    return dict(sorted(samples.items(), reverse=True))


def test_samples_are_those_of_the_oracle(session):
    canvas = Canvas(VIEW["height"], VIEW["width"], 2, origin=(VIEW["x"], VIEW["y"]))
    colors = np.asarray(small_scene().colors)[:, 0]
    picture = bytes_of(enlarge(small_scene(), 1.5, 1.5), VIEW, sr.Hard(samples=4))
    most_layers = 0
    for column, row in PIXELS:
        report, _ = inspect(session, column, row)
        facts, expected = report.header, covering(canvas, column, row)
        assert {layer["triangle"]: set(layer["samples"]) for layer in facts["layers"]} == expected
        top = [max((t for t in expected if k in expected[t]), default=-1) for k in range(4)]
        assert [sample["triangle"] for sample in facts["samples"]] == top
        for sample, triangle in zip(facts["samples"], top, strict=True):
            color = colors[triangle] if triangle >= 0 else [0.8, 0.8, 0.8]
            np.testing.assert_allclose(sample["color"], color, atol=1e-6)
        value = np.asarray(facts["value"], np.float32)
        assert np.abs(to_bytes(value).astype(int) - picture[row, column]).max() <= 1
        most_layers = max(most_layers, len(expected))
    assert most_layers >= 3


def test_the_lens_holds_the_samples_of_its_pixels(session):
    column, row = 14, 43
    report, _ = inspect(session, column, row)
    lens, rate = report.header["lens"], report.header["rate"]
    samples = np.frombuffer(report.payload, np.uint8).reshape(lens * rate, lens * rate, 4)
    means = samples.reshape(lens, rate, lens, rate, 4).mean(axis=(1, 3))[..., :3]
    picture = bytes_of(enlarge(small_scene(), 1.5, 1.5), VIEW, sr.Hard(samples=4))
    half = lens // 2
    expected = picture[row - half : row + half + 1, column - half : column + half + 1]
    assert len(np.unique(expected.reshape(-1, 3), axis=0)) > 5
    assert np.abs(means - expected).max() <= 1


def test_the_reference_is_the_exact_area(session):
    _, reference = inspect(session, 40, 30)
    scene = enlarge(small_scene(), 1.5, 1.5)
    plan = sr.plan(scene, height=64, width=96, origin=(10, 5), coverage=sr.Area())
    expected = np.asarray(sr.render(scene, plan))[30, 40]
    assert reference.header["name"] == "exact area"
    np.testing.assert_allclose(reference.header["value"], expected, atol=1e-5)


@pytest.mark.parametrize("coverage", ["soft", "area"])
def test_analytic_coverage_lists_what_each_triangle_covers(session, coverage):
    report, _ = inspect(session, 40, 30, settings={"coverage": coverage})
    scene = enlarge(small_scene(), 1.5, 1.5)
    option = sr.Soft(1.0) if coverage == "soft" else sr.Area()
    plan = sr.plan(scene, height=64, width=96, origin=(10, 5), coverage=option)
    layers = sr.pixel_layers(scene, plan, layers=8)
    used = np.asarray(layers.triangle)[30, 40]
    shares = np.asarray(layers.coverage)[30, 40]
    expected = dict(zip(used[used >= 0].tolist(), shares[used >= 0].tolist(), strict=True))
    listed = {layer["triangle"]: layer["coverage"] for layer in report.header["layers"]}
    assert list(listed) == list(expected)
    np.testing.assert_allclose(list(listed.values()), list(expected.values()), atol=1e-5)
    value = np.asarray(sr.render(scene, plan))[30, 40]
    np.testing.assert_allclose(report.header["value"], value, atol=1e-5)


def test_textures_and_depth_are_listed():
    texture = small_image()[:32, :32]
    scene = sr.Scene.from_soup(
        [[[0, 0], [64, 0], [64, 48]], [[0, 0], [64, 0], [0, 48]], [[0, 0], [64, 48], [0, 48]]],
        np.ones((3, 3)),
        uv=[[[0, 0], [1, 0], [0, 1]]] * 3,
        texture_index=[-1, 0, 0],
        textures=sr.TexturePyramid.build([texture]),
        depth=[[2, 2, 2], [1, 1, 1], [0.5, 0.5, 0.5]],
    )
    session = Session([SceneInMemory("ground", scene, HEIGHT, WIDTH)])
    view = {"zoom": 0.5, "x": 0, "y": 0, "height": 32, "width": 32}
    report, reference = inspect(session, 20, 5, view=view)
    plan = sr.plan(
        enlarge(scene, 0.5, 0.5), height=32, width=32, coverage=sr.Hard(4), filter=sr.Filter()
    )
    expected = np.asarray(sr.render(enlarge(scene, 0.5, 0.5), plan))[5, 20]
    np.testing.assert_allclose(report.header["value"], expected, atol=1e-5)
    first, second = report.header["layers"]
    assert first["triangle"] == 1 and first["depth"] == pytest.approx(1.0)
    # The second triangle has no texture.
    assert second["triangle"] == 0 and second["depth"] == pytest.approx(2.0)
    assert "level" not in second
    # Half the size on the screen: 32 texels across 32 pixels along x, and 32 across 24 along y.
    assert first["level"] == pytest.approx(np.log2(32 / 24), abs=1e-4)
    assert first["uv"] == pytest.approx([20.5 / 32, 5.5 / 24], abs=1e-4)
    assert reference.header["name"] == "256 samples"


def test_the_value_is_drawn_through_more_layers_than_are_listed():
    rng = np.random.default_rng(3)
    corners = np.array([[[-20, -20], [150, -20], [-20, 150]]], np.float32) * np.ones((12, 1, 1))
    colors = np.concatenate([rng.uniform(0, 1, (12, 3)), np.full((12, 1), 0.3)], axis=1)
    scene = sr.Scene.from_soup(corners.astype(np.float32), colors, background=[0.9, 0.1, 0.5])
    session = Session([SceneInMemory("glass", scene, HEIGHT, WIDTH)])
    view = {"zoom": 1.0, "x": 0, "y": 0, "height": 32, "width": 32}
    report, _ = inspect(session, 16, 16, view=view)
    expected = np.array([0.9, 0.1, 0.5])
    for color in colors:
        expected = 0.3 * color[:3] + 0.7 * expected
    np.testing.assert_allclose(report.header["value"], expected, atol=1e-5)
    for sample in report.header["samples"]:
        np.testing.assert_allclose(sample["color"], expected, atol=1e-5)
    assert [layer["triangle"] for layer in report.header["layers"]] == list(range(11, -1, -1))


def test_many_opaque_triangles_that_hide_each_other_are_inspected():
    rng = np.random.default_rng(4)
    centres = 16 + rng.uniform(-6, 6, (3000, 1, 2))
    corners = centres + np.array([[-4, -4], [4, -4], [0, 5]]) + rng.uniform(-1, 1, (3000, 3, 2))
    scene = sr.Scene.from_soup(corners.astype(np.float32), rng.uniform(0, 1, (3000, 3)))
    session = Session([SceneInMemory("heap", scene, HEIGHT, WIDTH)])
    view = {"zoom": 1.0, "x": 0, "y": 0, "height": 32, "width": 32}
    report, reference = inspect(session, 16, 16, view=view)
    assert len(report.header["layers"]) >= 8
    expected = bytes_of(scene, view, sr.Hard(samples=4))[16, 16]
    value = to_bytes(np.asarray(report.header["value"], np.float32))
    assert np.abs(value.astype(int) - expected).max() <= 1
    assert reference.header["name"] == "exact area"


def test_edges_are_the_triangles_in_view(session):
    (reply,) = ask(session, "edges")
    corners = np.frombuffer(reply.payload, np.float32).reshape(-1, 3, 2)
    scene = enlarge(small_scene(), 1.5, 1.5)
    expected = np.asarray(scene.positions)[np.asarray(scene.triangles)] - [10, 5]
    high, low = expected.max(axis=1), expected.min(axis=1)
    in_view = ((high >= -1) & (low <= [97, 65])).all(axis=1)
    assert in_view.sum() > 10
    np.testing.assert_allclose(corners, expected[in_view], atol=1e-4)


@pytest.mark.parametrize("coverage", ["sampled", "area"])
def test_tiles_list_the_triangles_that_touch_them(coverage):
    # Translucent triangles hide no others, so tiles list all that touch them.
    session = Session([SceneInMemory("glass", small_scene(channels=4), HEIGHT, WIDTH)])
    (reply,) = ask(session, "tiles", settings={"coverage": coverage, "samples": 1})
    facts = reply.header
    lengths = np.frombuffer(reply.payload, np.uint32).reshape(facts["rows"], facts["columns"])
    canvas = Canvas(VIEW["height"], VIEW["width"], 1, origin=(VIEW["x"], VIEW["y"]))
    scene = enlarge(small_scene(), 1.5, 1.5)
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)]
    height, width = facts["tile_height"], facts["tile_width"]
    touching = np.zeros(lengths.shape, int)
    for footprint in footprints(corners, canvas):
        inside = np.zeros((facts["rows"] * height, facts["columns"] * width), bool)
        inside[: canvas.height, : canvas.width][footprint.rows, footprint.columns] = (
            footprint.inside
        )
        touching += inside.reshape(facts["rows"], height, -1, width).any(axis=(1, 3))
    # A listed triangle may touch a tile, but cover none of its samples.
    assert (lengths >= touching).all() and touching.max() >= 5
    assert (lengths - touching).mean() < 1
    assert facts["max"] == lengths.max()


def test_gradients_are_those_of_the_difference(session):
    (reply,) = ask(session, "gradients", target=1)
    rows = np.frombuffer(reply.payload, np.float32).reshape(-1, 4)
    scene = enlarge(small_scene(), 1.5, 1.5)
    plan = sr.plan(scene, height=64, width=96, origin=(10, 5), coverage=sr.Hard(samples=4))
    target = np.asarray(pixels_of_image(session), np.float32) / np.float32(255)

    def loss(positions: jax.Array) -> jax.Array:
        from dataclasses import replace

        image = sr.render(replace(scene, positions=positions), plan)
        weight = target[..., 3:]
        return (weight * (image - target[..., :3]) ** 2).sum() / (3 * weight.sum())

    gradient = np.asarray(jax.jit(jax.grad(loss))(scene.positions))
    vertices = np.asarray(scene.positions) - [10, 5]
    in_view = ((vertices >= 0) & (vertices <= [96, 64])).all(axis=1)
    assert in_view.sum() == len(rows) > 20
    order = np.argsort(-np.hypot(*gradient[in_view].T), kind="stable")
    np.testing.assert_allclose(rows[:, :2], vertices[in_view][order], atol=1e-4)
    np.testing.assert_allclose(rows[:, 2:], gradient[in_view][order], atol=1e-7)


def pixels_of_image(session: Session) -> np.ndarray:
    """The target at the view, `[64, 96, 4]`."""
    (reply,) = ask(session, "picture", subject=1)
    return np.frombuffer(reply.payload, np.uint8).reshape(64, 96, 4)


def test_costs_come_one_by_one(session):
    replies = ask(session, "costs", settings={"samples": 4})
    effects = [reply.header["effect"] for reply in replies]
    assert effects == [None, "guard band"]
    assert [reply.header["is_last"] for reply in replies] == [False, True]
    assert all(reply.header["milliseconds"] > 0 for reply in replies)


def test_a_png_holds_the_picture(session, tmp_path):
    (reply,) = ask(session, "png")
    path = tmp_path / "view.png"
    path.write_bytes(reply.payload)
    picture = bytes_of(enlarge(small_scene(), 1.5, 1.5), VIEW, sr.Hard(samples=4))
    np.testing.assert_array_equal(to_bytes(sr.read_image(path)), picture)
