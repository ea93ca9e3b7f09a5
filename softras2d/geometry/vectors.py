"""Products of plane vectors. Host only, numpy."""

import numpy as np
from jaxtyping import Float


def cross(u: Float[np.ndarray, "... 2"], v: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "..."]:
    """Cross product u x v: twice the signed area of the triangle that the two vectors span."""
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
