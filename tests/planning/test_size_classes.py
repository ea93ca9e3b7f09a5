"""`pad` to size classes changes no bit of an image; scenes of many sizes share few programs."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.numerics import compiled_programs

SIZE = 40
MODES = {
    "hard": sr.Hard(samples=4),
    "hard 9": sr.Hard(samples=9),
    "hard top left": sr.Hard(samples=16, fill_rule="top_left"),
    "soft": sr.Soft(2.0),
    "area": sr.Area(),
    "area sum": sr.Area("sum"),
}


def _scene(count: int, kind: str = "flat", *, side: float = SIZE, seed: int = 0) -> sr.Scene:
    """A random soup; the first triangle has no area and lies on the samples of a row.

    `kind` names effects; "flat" and "depth" alone have one colour per triangle.
    """
    rng = np.random.default_rng(seed)
    middle = rng.uniform(0, side, (count, 1, 2))
    corners = (middle + rng.normal(size=(count, 3, 2)) * 12).astype(np.float32)
    corners[0] = [[4.5, 4.5], [9.5, 4.5], [14.5, 4.5]]
    shape = (count, 1 if kind in ("flat", "depth") else 3, 4 if kind == "translucent" else 3)
    arrays = {
        "positions": corners.reshape(-1, 2),
        "triangles": np.arange(3 * count, dtype=np.int32).reshape(-1, 3),
        "colors": rng.random(shape, dtype=np.float32),
        "background": np.ones(3, np.float32),
    }
    if "textured" in kind:
        arrays["uv"] = rng.random((count, 3, 2), dtype=np.float32)
        arrays["texture_index"] = rng.integers(-1, 1, count).astype(np.int32)
        arrays["textures"] = sr.TexturePyramid.build([rng.random((9, 7, 3), dtype=np.float32)])
    if "depth" in kind:
        arrays["depth"] = rng.random(3 * count, dtype=np.float32)
    if "perspective" in kind:
        arrays["inverse_w"] = rng.uniform(0.5, 1, 3 * count).astype(np.float32)
    return sr.Scene(**jax.device_put(arrays))


def _gradient(scene: sr.Scene, plan: sr.Plan) -> sr.Scene:
    def loss(scene: sr.Scene):
        image = sr.render(scene, plan)
        return jnp.sum(
            image * jnp.cos(jnp.arange(image.size, dtype=jnp.float32)).reshape(image.shape)
        )

    return jax.jit(jax.grad(loss, allow_int=True))(scene)


def _assert_prefix(padded, given, axis: int = 0) -> None:
    """Assert that the first entries are `given`, and the appended ones zero."""
    for after, before in zip(jax.tree.leaves(padded), jax.tree.leaves(given), strict=True):
        if after.dtype == jax.dtypes.float0:
            continue
        first, rest = np.split(np.asarray(after), [before.shape[axis]], axis)
        np.testing.assert_array_equal(first, before)
        assert not rest.any()


CASES = [
    ("hard", "flat"),
    *(
        pytest.param(mode, kind, marks=pytest.mark.slow)
        for mode, kind in (
            ("hard 9", "translucent"),
            ("hard top left", "corners"),
            ("hard", "textured with depth and perspective"),
            ("soft", "depth"),
            ("area", "textured"),
            ("area sum", "flat"),
        )
    ),
]


@pytest.mark.parametrize(("mode", "kind"), CASES)
def test_padding_changes_no_bit_of_image_and_gradient(mode, kind):
    scene = _scene(20, kind)
    padded = sr.pad(scene)
    assert padded.triangles.shape[0] == 64
    options = {"height": SIZE, "width": SIZE - 8, "coverage": MODES[mode], "origin": (-3, 2)}
    plan = sr.plan(scene, **options)
    again = sr.plan(padded, **options)
    assert jax.tree.structure(plan) == jax.tree.structure(again)
    draw = jax.jit(sr.render)
    image = np.asarray(draw(scene, plan))
    np.testing.assert_array_equal(draw(padded, plan), image)
    np.testing.assert_array_equal(sr.render(scene, plan), image)
    _assert_prefix(_gradient(padded, plan), _gradient(scene, plan))


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["hard", "soft", "area"])
def test_second_order_products_of_padding_are_zero(mode):
    scene = sr.pad(_scene(20))
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=MODES[mode])

    def gradient(positions):
        draw = lambda x: jnp.sum(sr.render(replace(scene, positions=x), plan) ** 2)  # noqa: E731
        return jax.grad(draw)(positions)

    # The direction moves the padding too, which must not change the products.
    step = jnp.ones_like(scene.positions)
    gradients, product = jax.jit(lambda x: jax.jvp(gradient, (x,), (step,)))(scene.positions)
    assert np.isfinite(gradients).all() and np.isfinite(product).all()
    assert not np.asarray(gradients[60:]).any() and not np.asarray(product[60:]).any()


def test_padding_is_invisible_even_if_its_vertex_moves():
    """Padding triangles are at vertex 0, which an optimizer may move onto a sample."""
    scene = _scene(1)
    padded = sr.pad(replace(scene, positions=jnp.full((3, 2), 4.25, jnp.float32)))
    for coverage in (sr.Hard(samples=4), sr.Soft(8.0), sr.Area()):
        plan = sr.plan(padded, height=8, width=8, coverage=coverage)
        alone = replace(padded, triangles=jnp.zeros_like(padded.triangles))
        assert (np.asarray(sr.render(alone, plan)) == 1).all()


def test_a_batch_is_padded_and_shapes_are_classes():
    scenes = [_scene(30, "textured", seed=seed) for seed in range(2)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)
    padded = sr.pad(batch)
    for k, scene in enumerate(scenes):
        of_batch = jax.tree.map(lambda leaf, k=k: leaf[k], padded)
        for actual, expected in zip(
            jax.tree.leaves(of_batch), jax.tree.leaves(sr.pad(scene)), strict=True
        ):
            np.testing.assert_array_equal(actual, expected)
    assert sr.pad(padded) is not batch
    assert sr.pad(padded).triangles is padded.triangles
    counts = [sr.pad(_scene(count)).triangles.shape[0] for count in (1, 65, 1025, 2049, 5000)]
    assert counts == [64, 1024, 2048, 4096, 8192]
    shared = sr.Scene.from_mesh(
        np.zeros((40, 2), np.float32), np.zeros((70, 3), np.int32), triangle_colors=np.ones((70, 3))
    )
    assert sr.pad(shared).positions.shape == (1024, 2)


@pytest.mark.parametrize(
    ("vertices", "size"), [(10, 64), (30, 192), (40, 64), (100, 192), (180, 256), (300, 512)]
)
def test_padding_twice_changes_nothing(vertices, size):
    scene = sr.Scene.from_mesh(
        np.zeros((vertices, 2), np.float32),
        np.arange(30, dtype=np.int32).reshape(10, 3) % vertices,
        triangle_colors=np.ones((10, 3), np.float32),
    )
    padded = sr.pad(scene)
    assert padded.positions.shape == (size, 2)
    assert sr.pad(padded).positions is padded.positions


def test_an_empty_scene_stays_and_a_traced_one_is_refused():
    empty = sr.Scene.from_soup(np.zeros((0, 3, 2)), np.zeros((0, 3)))
    assert sr.pad(empty) is empty
    with pytest.raises(ValueError, match="outside jit"):
        jax.eval_shape(sr.pad, _scene(3))


def _random_sizes(renders: int, gradients: int, seed: int) -> None:
    """Render soups of 100 to 2,000 triangles, and their gradients, with a plan for each."""
    rng = np.random.default_rng(seed)
    gradient = jax.jit(jax.grad(_brightness))
    for number in range(renders):
        scene = _scene(int(rng.integers(100, 2001)), side=256, seed=number)
        plan = sr.plan(scene, height=256, width=256, coverage=sr.Hard(samples=4))
        np.asarray(sr.render(scene, plan))
        if number < gradients:
            padded = sr.pad(scene)
            np.asarray(gradient(padded.positions, padded, plan))


def _brightness(positions, scene: sr.Scene, plan: sr.Plan):
    return jnp.mean(sr.render(replace(scene, positions=positions), plan) ** 2)


@pytest.mark.slow
def test_scenes_of_many_sizes_share_programs(count_compilations):
    with count_compilations() as compiled:
        _random_sizes(8, 0, seed=1)
    assert len(compiled) <= 5, compiled.names


@pytest.mark.slow
def test_fits_of_similar_size_share_programs(count_compilations, monkeypatch):
    # A process that has run many tests would drop its programs between the two fits.
    monkeypatch.setattr(compiled_programs, "_SHARE", 1.0)
    target = np.random.default_rng(0).random((24, 24, 3)).astype(np.float32)
    fits = {"steps": 2, "size": 24, "softness": 1.0}
    jax.clear_caches()
    with count_compilations() as compiled_first:
        sr.fit(target, triangles=29, **fits)
    with count_compilations() as compiled_later:
        result = sr.fit(target, triangles=31, **fits)
    assert result.scene.triangles.shape[0] <= 31
    large = {name for name in compiled_first.names if "advance" in name or "render" in name}
    assert large
    assert not large & set(compiled_later.names)


@pytest.mark.slow
def test_a_hundred_sizes_compile_twelve_programs_at_most(count_compilations):
    """All sizes together use hardly more memory, and memory maps, than the first ones."""
    with count_compilations() as compiled:
        _random_sizes(100, 25, seed=0)
        assert len(compiled) <= 12, compiled.names
        before = _maps_and_memory()
        _random_sizes(40, 10, seed=0)
    after = _maps_and_memory()
    assert after[0] - before[0] < 300
    assert after[1] - before[1] < 50


def _maps_and_memory() -> tuple[int, float]:
    """Number of memory maps, and resident memory in MiB."""
    if not Path("/proc/self/maps").exists():
        pytest.skip("counts maps as Linux has them")
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return Path("/proc/self/maps").read_bytes().count(b"\n"), pages * 4096 / 2**20


def test_programs_are_dropped_before_the_limit(monkeypatch, tmp_path, count_compilations):
    maps, limit = tmp_path / "maps", tmp_path / "limit"
    monkeypatch.setattr(compiled_programs, "_MAPS", maps)
    monkeypatch.setattr(compiled_programs, "_LIMIT", limit)
    assert not compiled_programs.drop_programs()
    double = jax.jit(lambda x: 2 * x)
    double(np.float32(1))
    maps.write_text("map\n" * 100)
    limit.write_text("1000\n")
    with count_compilations() as compiled:
        assert not compiled_programs.drop_programs()
        double(np.float32(1))
    assert len(compiled) == 0
    limit.write_text("200\n")
    with count_compilations() as compiled:
        assert compiled_programs.drop_programs()
        double(np.float32(1))
    assert len(compiled) == 1
