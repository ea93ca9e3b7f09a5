"""Transfer of arrays from the host to JAX without compilation.

`jnp.asarray` of a NumPy array compiles a program for every shape, as do casts, reshapes and
indexing of concrete JAX arrays. Each such program takes 8 ms and 1.4 MB, and stays in memory for
the life of the process. So concrete arrays are prepared in NumPy, and `to_device` passes them to
JAX by `jax.device_put`, which compiles nothing.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array

Device = Any
"""A `jax.Device`, which type checkers take for a variable."""

Devices = Sequence[Any]
"""A sequence of `jax.Device`."""


def to_device(value: Any, dtype: Any = None) -> Array:
    """Convert `value` to a JAX array of `dtype`, compiling nothing for host arrays.

    A `dtype` of None keeps the dtype of `value`. JAX arrays and tracers that already have the dtype
    are returned as they are; host arrays are always copied. Without `jax_enable_x64`, 64-bit
    numbers become 32-bit numbers, as with `jnp.asarray`. Floats too large for the dtype become
    infinite.
    """
    dtype = None if dtype is None else jax.dtypes.canonicalize_dtype(dtype)
    if isinstance(value, jax.Array) and dtype in (None, value.dtype):
        return value
    if isinstance(value, Tracer):
        return value.astype(dtype)
    host = np.asarray(value)
    wanted = jax.dtypes.canonicalize_dtype(host.dtype) if dtype is None else dtype
    # The array is always copied: on a CPU, JAX may share the memory of the NumPy array, and later
    # changes that callers make to their arrays must not change the scene.
    with np.errstate(over="ignore"):
        return jax.device_put(np.array(host, wanted))


def to_host(value: Any) -> Any:
    """Convert a concrete value to a NumPy array, so that later operations compile nothing.

    NumPy arrays and tracers are returned as they are, not copied. Lists and tuples with tracers
    become traced arrays.
    """
    if isinstance(value, Tracer):
        return value
    if isinstance(value, list | tuple) and is_traced(value):
        return jnp.asarray(value)
    return np.asarray(value)


def check_devices(devices: Devices) -> list[Device]:
    """Return devices as a list; raise `ValueError` unless they are one or more devices of JAX."""
    # A single device, too, is a likely argument.
    listed = list(devices) if hasattr(devices, "__iter__") else []
    if not hasattr(devices, "__iter__") or not all(isinstance(d, jax.Device) for d in listed):
        raise ValueError(f"`devices` must be a list of devices of JAX; got {devices!r:.60}.")
    if not listed:
        raise ValueError("`devices` must have at least one device; got none.")
    return listed


def is_traced(tree: Any) -> bool:
    """Whether some leaf of a tree is a tracer, whose value is known only when a program runs."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))
