"""A function that a batch runs element by element is right under every transformation of JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softras2d.numerics.one_by_one import one_by_one


def plain(inputs):
    """A function of a tree that returns a tree, both with integers; `power` is an exponent."""
    x, power = inputs["x"], inputs["power"]
    wave = jnp.sin(x) ** power.astype(x.dtype) * inputs["scale"]
    return {"sum": jnp.sum(wave), "wave": wave, "doubled": 2 * power}


wrapped = one_by_one(plain)


def inputs_of(seed, batch=()):
    rng = np.random.default_rng(seed)
    return {
        "x": jnp.asarray(rng.uniform(0.5, 1.5, (*batch, 4)), jnp.float32),
        "power": jnp.asarray(rng.integers(1, 4, batch), jnp.int32),
        "scale": jnp.asarray(rng.uniform(1, 2, batch), jnp.float32),
    }


def loss_of(function):
    """A scalar function of the floats in the inputs and of the integers."""

    def loss(floats, power):
        outputs = function(floats | {"power": power})
        return outputs["sum"] ** 2 + jnp.sum(outputs["wave"] ** 3)

    return loss


def split(inputs):
    """Split the inputs into floats and integers."""
    return {name: inputs[name] for name in ("x", "scale")}, inputs["power"]


def assert_same(actual, expected):
    assert jax.tree.structure(actual) == jax.tree.structure(expected)
    for a, b in zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True):
        assert (a.shape, a.dtype) == (b.shape, b.dtype)
        np.testing.assert_allclose(a, b, rtol=1e-5)


def runs_one_by_one(function, *arguments):
    """Whether the traced program loops over the elements of a batch."""
    return "scan[" in str(jax.make_jaxpr(function)(*arguments))


def test_values_are_those_of_the_function():
    inputs = inputs_of(0)
    assert_same(wrapped(inputs), plain(inputs))
    assert_same(jax.jit(wrapped)(inputs), plain(inputs))
    assert not runs_one_by_one(wrapped, inputs)


def derivatives_of(function, transform, floats, power):
    """Value, gradient, tangent, linear map and second derivative, computed in one program."""

    def loss(floats):
        return transform(loss_of(function))(floats, power)

    return {
        "value and gradient": jax.value_and_grad(loss)(floats),
        "jvp": jax.jvp(loss, (floats,), (floats,)),
        "linearize": jax.linearize(loss, floats)[1](floats),
        "jvp of gradient": jax.jvp(jax.grad(loss), (floats,), (floats,)),
    }


@pytest.mark.parametrize("transform", [lambda f: f, jax.jit, jax.checkpoint])
def test_derivatives_are_those_of_the_function(transform):
    derivatives = jax.jit(derivatives_of, static_argnums=(0, 1))
    floats, power = split(inputs_of(0))
    expected = derivatives(plain, lambda f: f, floats, power)
    assert_same(derivatives(wrapped, transform, floats, power), expected)


def test_a_batch_is_computed_one_by_one():
    inputs = inputs_of(0, (3,))
    assert runs_one_by_one(jax.vmap(wrapped), inputs)
    assert_same(jax.vmap(wrapped)(inputs), jax.jit(jax.vmap(plain))(inputs))


def test_a_batch_of_batches_is_computed_one_by_one():
    inputs = inputs_of(0, (2, 3))
    nested = jax.jit(jax.vmap(jax.vmap(wrapped)))
    assert str(jax.make_jaxpr(nested)(inputs)).count("scan[") == 2
    assert_same(nested(inputs), jax.jit(jax.vmap(jax.vmap(plain)))(inputs))


@pytest.mark.parametrize("batched", ["x", "power", "scale"])
def test_what_is_not_batched_is_shared(batched):
    inputs = inputs_of(0) | {batched: inputs_of(1, (3,))[batched]}
    axes = ({name: 0 if name == batched else None for name in inputs},)
    expected = jax.jit(jax.vmap(plain, axes))(inputs)
    assert_same(jax.jit(jax.vmap(wrapped, axes))(inputs), expected)
    assert runs_one_by_one(jax.vmap(wrapped, axes), inputs)


def test_the_batch_may_be_any_axis():
    inputs = inputs_of(0, (3,)) | {"x": inputs_of(0, (3,))["x"].T}
    axes = ({"x": 1, "power": 0, "scale": 0},)
    expected = jax.jit(jax.vmap(plain, axes))(inputs)
    assert_same(jax.jit(jax.vmap(wrapped, axes))(inputs), expected)


def derivatives_of_batch(function, floats, power):
    """Derivatives of a batch, or of a batch of batches, with vmap and grad in either order."""

    def vectorised(function):
        for _ in power.shape:
            function = jax.vmap(function)
        return function

    def total(floats):
        return jnp.sum(vectorised(loss_of(function))(floats, power))

    return {
        "grad of vmap": jax.grad(total)(floats),
        "grad of checkpoint of vmap": jax.grad(jax.checkpoint(total))(floats),
        "vmap of grad": vectorised(jax.grad(loss_of(function)))(floats, power),
        "jvp of vmap": jax.jvp(total, (floats,), (floats,)),
    }


@pytest.mark.parametrize("batch", [(3,), (2, 3)])
def test_derivatives_of_a_batch_are_those_of_the_function(batch):
    derivatives = jax.jit(derivatives_of_batch, static_argnums=0)
    floats, power = split(inputs_of(2, batch))
    of_batch = derivatives(wrapped, floats, power)
    assert_same(of_batch, derivatives(plain, floats, power))
    assert_same(of_batch["grad of vmap"], of_batch["vmap of grad"])


def test_a_gradient_of_a_batch_outside_jit_equals_a_loop():
    floats, power = split(inputs_of(2, (3,)))
    batch = jax.vmap(loss_of(wrapped))
    gradients = jax.grad(lambda floats: jnp.sum(batch(floats, power)))(floats)
    of_element = jax.jit(jax.grad(loss_of(plain)))
    for at in range(3):
        element = jax.tree.map(lambda leaf, at=at: leaf[at], (floats, power, gradients))
        assert_same(element[2], of_element(*element[:2]))


def test_the_gradient_of_a_batch_stores_no_intermediate_arrays():
    """Only inputs are stored for the backward pass, which computes each element again.

    Plain reverse mode would also store the result of every sine.
    """

    def deep(x):
        for _ in range(5):
            x = jnp.sin(x)
        return x

    floats = jnp.linspace(0.1, 1.2, 12).reshape(3, 4)
    vjp = jax.vjp(jax.vmap(one_by_one(deep)), floats)[1]
    stored = sum(leaf.size for leaf in jax.tree.leaves(vjp))
    assert stored <= floats.size
    expected = jax.vjp(jax.vmap(deep), floats)[1]
    assert_same(vjp(floats), expected(floats))
