"""Arguments that must be integers are accepted in every form of one, and refused in one line."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softras2d.numerics.integer_arguments import checked_integer


@pytest.mark.parametrize("value", [3, np.int64(3), np.uint8(3), np.array(3), jnp.int32(3)])
def test_integers_of_every_library_become_pythons(value):
    count = checked_integer("count", value, 1, 3)
    assert type(count) is int and count == 3


@pytest.mark.parametrize("value", [0, True, np.True_, 2.0, np.float32(2), "2", None, [2]])
def test_anything_else_is_refused(value):
    with pytest.raises(ValueError) as caught:
        checked_integer("count", value, 1)
    assert str(caught.value) == f"`count` must be an integer of 1 or more; got {value!r}."


def test_a_range_is_named():
    with pytest.raises(ValueError, match=r"`count` must be an integer in 1\.\.8; got 9\."):
        checked_integer("count", 9, 1, 8)


def test_a_traced_integer_is_refused():
    with pytest.raises(ValueError, match="`count` must be an integer of 1 or more; got "):
        jax.jit(lambda count: checked_integer("count", count, 1))(2)
