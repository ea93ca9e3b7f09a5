"""Products of plane vectors. Host only, numpy."""

import numpy as np
from jaxtyping import Float


def cross(u: Float[np.ndarray, "... 2"], v: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "..."]:
    """Cross product u_x v_y - u_y v_x: twice the signed area of the triangle that u and v span."""
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
