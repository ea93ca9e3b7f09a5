"""A scene that exceeds its plan under `jit` gives an error or NaN, even in derivatives alone."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.rendering import overflow
from softras2d.rendering.overflow import _nan_if

from ..cases.derivatives import assert_near
from ..cases.overflow import SIDE, small_and_large_scene, too_large_for_plan

COVERAGES = {"hard": sr.Hard(4), "soft": sr.Soft(1.0), "area": sr.Area()}

LOSSES = {
    "linear": lambda image: jnp.sum(0.3 * image),
    "constant": lambda image: jnp.sum(0 * image),
    "one pixel": lambda image: image[3, 3, 0],
}


@pytest.mark.parametrize(
    "name",
    [name if name == "hard" else pytest.param(name, marks=pytest.mark.slow) for name in COVERAGES],
)
def test_gradients_raise_even_if_the_loss_ignores_most_pixels(name):
    scene, plan = too_large_for_plan(COVERAGES[name])
    assert sr.render_checked(scene, plan)[1]
    for loss in LOSSES.values():

        def of_positions(positions, loss=loss):
            return loss(sr.render(replace(scene, positions=positions), plan))

        with pytest.raises(Exception, match="outgrew its plan"):
            jax.jit(jax.grad(of_positions))(scene.positions).block_until_ready()


def test_tangents_raise():
    scene, plan = too_large_for_plan(sr.Hard(4))

    def of_positions(positions):
        return sr.render(replace(scene, positions=positions), plan)

    tangent = jax.jit(lambda x: jax.jvp(of_positions, (x,), (jnp.ones_like(x),))[1])
    with pytest.raises(Exception, match="outgrew its plan"):
        tangent(scene.positions).block_until_ready()


@pytest.mark.parametrize("overflow", [False, True])
def test_derivatives_are_nan_in_both_directions(overflow):
    """Derivatives with respect to all floats are NaN, whatever the weights of the pixels are.

    Without overflow, the same plan changes no bit.
    """
    leaves = [jnp.arange(6.0).reshape(3, 2), jnp.ones(4)]

    def image_of(leaves):
        image = jnp.sin(leaves[0].sum()) * jnp.ones((2, 2, 3)) + leaves[1][0]
        return _nan_if(image, leaves, jnp.asarray(overflow))

    def plain(leaves):
        return jnp.sin(leaves[0].sum()) * jnp.ones((2, 2, 3)) + leaves[1][0]

    image, tangent = jax.jvp(image_of, (leaves,), (leaves,))
    gradients = [
        jax.grad(lambda leaves, w=weight: jnp.sum(w * image_of(leaves)))(leaves)
        for weight in (0.0, 0.3)
    ]
    batch = jax.vmap(jax.grad(lambda leaves: jnp.sum(image_of(leaves))))(
        jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), leaves)
    )
    if overflow:
        for leaf in jax.tree.leaves((image, tangent, gradients, batch)):
            assert np.isnan(leaf).all()
        return
    expected, expected_tangent = jax.jvp(plain, (leaves,), (leaves,))
    assert eqx.tree_equal((image, tangent), (expected, expected_tangent))
    expected_gradient = jax.grad(lambda leaves: jnp.sum(0.3 * plain(leaves)))(leaves)
    assert eqx.tree_equal(gradients[1], expected_gradient)
    assert np.isfinite(jax.tree.leaves(batch)[0]).all()


@pytest.fixture
def complaints(monkeypatch):
    """A list of the error messages that compiled programs raise."""
    messages = []

    complain = overflow.overflow_message

    def record(outcome, plan, **options):
        messages.append(complain(outcome, plan, **options))
        return messages[-1]

    monkeypatch.setattr(overflow, "overflow_message", record)
    return messages


@pytest.mark.parametrize("name", ["vmap", pytest.param("grad of vmap", marks=pytest.mark.slow)])
def test_a_batch_raises_one_error_once(name, complaints):
    """Two of the three scenes in the batch outgrow the plan."""
    small, large = small_and_large_scene()
    plan = sr.plan(small, height=SIDE, width=SIDE, coverage=sr.Hard(4))

    def images(positions):
        return jax.vmap(lambda one: sr.render(replace(small, positions=one), plan))(positions)

    def gradient(positions):
        return jax.grad(lambda positions: jnp.sum(0.3 * images(positions)))(positions)

    program = jax.jit({"vmap": images, "grad of vmap": gradient}[name])
    sizes = [scene.positions for scene in (large, small, large)]
    jax.block_until_ready(program(jnp.stack([small.positions] * 3)))
    assert not complaints
    with pytest.raises(Exception, match="outgrew its plan") as raised:
        jax.block_until_ready(program(jnp.stack(sizes)))
    assert str(raised.value).count("outgrew its plan") == 1
    assert len(complaints) == 1


@pytest.mark.slow
def test_only_the_scenes_that_outgrow_their_plan_are_nan():
    small, large = small_and_large_scene()
    plan = sr.plan(small, height=SIDE, width=SIDE, coverage=sr.Hard(4), on_overflow="nan")
    gradient = jax.grad(
        lambda positions: jnp.sum(0.3 * sr.render(replace(small, positions=positions), plan) ** 2)
    )
    sizes = jnp.stack([scene.positions for scene in (large, small, large)])
    of_batch = jax.jit(jax.vmap(gradient))(sizes)
    assert np.isnan(of_batch[0]).all()
    assert np.isnan(of_batch[2]).all()
    assert_near(of_batch[1], jax.jit(gradient)(small.positions), 1e-5, least=0)


@pytest.mark.slow
def test_buffers_and_composited_layers_of_an_outgrown_plan_are_nan():
    """This holds under `jit` too, where the overflow is known only when the program runs."""
    scene, plan = too_large_for_plan(sr.Hard(4))
    plan = replace(plan, on_overflow="nan")
    # Layers need only lists of pairs, which are long enough until the triangles grow.
    scene = replace(scene, positions=scene.positions * 20)

    @jax.jit
    def buffers(scene):
        visible = sr.rasterize(scene, plan, layers=2)
        red = jnp.ones((*visible.triangle.shape, 3))
        image = sr.composite(visible, red)
        return (visible.barycentric, visible.coverage, image), visible.overdraw

    floats, overdraw = buffers(scene)
    for buffer in floats:
        assert np.isnan(buffer).all()
    assert (overdraw == -1).all()
