"""Reads shapes, dtypes and values of the leaves of a pytree, and never raises.

JAX and Equinox rebuild pytrees with leaves that are not arrays: tracers, shapes without values,
None, axis numbers, sharding specifications, `object()`. Error messages and debuggers call `repr` on
such trees, where an exception would hide the message that was being written.
"""

from typing import Any

import jax
import numpy as np
from jax.core import Tracer


def field_of(value: Any, name: str) -> Any:
    """The attribute `name` of an object; None if it has none, or if reading it raises."""
    try:
        return getattr(value, name)
    except Exception:
        return None


def shape_of(leaf: Any) -> tuple[Any, ...] | None:
    """The `shape` of an array, a tracer or a `jax.ShapeDtypeStruct`; None unless it is a tuple."""
    shape = field_of(leaf, "shape")
    return shape if isinstance(shape, tuple) else None


def size_of(leaf: Any, axis: int) -> Any:
    """The size of an array along an axis; None if it has too few axes, or is not an array.

    `axis` is negative: -1 is the last axis.
    """
    shape = shape_of(leaf)
    return None if shape is None or len(shape) < -axis else shape[axis]


def dtype_of(leaf: Any) -> str | None:
    """The name of the dtype of an array; None for anything else."""
    dtype = field_of(leaf, "dtype")
    return None if dtype is None or shape_of(leaf) is None else str(dtype)


def values_of(leaf: Any) -> np.ndarray | None:
    """The values of a concrete array, as a NumPy array; None for anything else.

    None too if they cannot be read, as those of a donated array.
    """
    if isinstance(leaf, Tracer) or not isinstance(leaf, np.ndarray | jax.Array):
        return None
    try:
        return np.asarray(leaf)
    except Exception:
        # For example, an array that was donated, or that is distributed over processes.
        return None
