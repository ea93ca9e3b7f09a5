"""A function is exchanged for another one exactly where chosen arguments are differentiated."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softras2d.numerics.differentiated import unless_differentiated


def _call(calls: list[str]):
    """The product of the watched array with two others; `calls` gets the name of each program."""

    def program(name: str):
        def product(watched, rest):
            calls.append(name)
            scale, number = rest
            return watched * scale * number

        return product

    chosen = unless_differentiated(program("usual"), program("otherwise"))
    return lambda watched, scale: chosen(watched, (scale, jnp.asarray(3)))


@pytest.mark.parametrize("compiled", [False, True])
def test_the_program_depends_on_what_is_differentiated(compiled):
    x, y = jnp.asarray(2.0), jnp.asarray(5.0)
    for arguments, expected, name in (
        ((), 30.0, "usual"),
        (0, 15.0, "otherwise"),
        (1, 6.0, "usual"),
        ((0, 1), (15.0, 6.0), "otherwise"),
    ):
        calls: list[str] = []
        function = _call(calls)
        function = jax.jit(function) if compiled else function
        derivative = function if arguments == () else jax.grad(function, argnums=arguments)
        np.testing.assert_allclose(derivative(x, y), expected)
        assert calls[-1] == name


def test_both_modes_and_batches_agree():
    x, y = jnp.arange(1.0, 4.0), jnp.arange(4.0, 7.0)
    function = _call([])
    _, tangent = jax.jvp(function, (x, y), (jnp.ones(3), 2 * jnp.ones(3)))
    np.testing.assert_allclose(tangent, 3 * (y + 2 * x))
    by_x, by_y = jax.vmap(jax.grad(function, argnums=(0, 1)))(x, y)
    np.testing.assert_allclose(by_x, 3 * y)
    np.testing.assert_allclose(by_y, 3 * x)
