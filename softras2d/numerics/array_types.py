"""Types for functions that run on the host, in numpy, and on the device, in JAX, alike.

Such a function takes its operations from `x.__array_namespace__()`, which is `numpy` for a host
array and `jax.numpy` for a JAX array (the Python array API standard). A plan uses it to count on
the host what a render does on the device.
"""

from typing import Any

HostOrDeviceArray = Any
"""A numpy array or a JAX array.

Their union would be the type. No type checker accepts it here: the two libraries declare different
operators, and the same function would have to be checked once for each.
"""

DTypeLike = Any
"""A dtype of numpy or JAX, or a scalar type such as `jnp.float32`."""
