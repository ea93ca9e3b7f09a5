"""Profiles of soft coverage: smooth steps as functions of the signed distance from an edge.

A profile is 1/2 at the edge, 0.9 half a width inside it and 0.1 half a width outside. It reaches 1
and 0 at a finite distance, its support: a logistic is cut there, and rescaled so that no step is
left.

**Source:** Liu, Li, Chen and Li, *Soft Rasterizer* (ICCV 2019), section 3.2, equation 1, for the
logistic in the squared distance.
"""

import math
from typing import Any

import jax.numpy as jnp

_TAIL = 6.0
"""Argument z at which the logistic 1 / (1 + e^-z) is cut, where it is within 0.0025 of 1."""

_REST = 1.0 / (1.0 + math.exp(_TAIL))
_NINETY = 0.9 - 0.8 * _REST
_LOGIT = math.log(_NINETY / (1.0 - _NINETY))
"""Argument z at which the cut and rescaled logistic is 0.9."""

# 3 u^2 - 2 u^3 = 0.9, by the trigonometric solution of the cubic.
_WINDOW = 0.5 + math.sin(math.asin(0.8) / 3)

SUPPORT = {
    "logistic": 0.5 * _TAIL / _LOGIT,
    "softras": 0.5 * math.sqrt(_TAIL / _LOGIT),
    "window": 0.25 / (_WINDOW - 0.5),
}
"""Distance from the edge, in widths, at which each profile reaches 0 outside and 1 inside."""


def step(profile: str, q: Any) -> Any:
    """Evaluate a profile of soft coverage, in 0..1, at a signed distance from the edge.

    `profile` is `Soft.profile`. `q` is the distance divided by `Soft.width`, positive inside.
    """
    if profile == "window":
        u = jnp.clip(0.5 + q * (0.5 / SUPPORT["window"]), 0.0, 1.0)
        return u * u * (3.0 - 2.0 * u)
    z = jnp.clip(_exponent(profile, q), -_TAIL, _TAIL)
    return jnp.clip((1.0 / (1.0 + jnp.exp(-z)) - _REST) / (1.0 - 2.0 * _REST), 0.0, 1.0)


def profile_derivative(profile: str, q: Any) -> Any:
    """Evaluate the derivative of `step` with respect to `q`; it is 0 beyond the support."""
    if profile == "window":
        scale = 0.5 / SUPPORT["window"]
        u = jnp.clip(0.5 + q * scale, 0.0, 1.0)
        return 6.0 * u * (1.0 - u) * scale
    z = _exponent(profile, q)
    p = 1.0 / (1.0 + jnp.exp(-jnp.clip(z, -_TAIL, _TAIL)))
    rate = 2.0 * _LOGIT if profile == "logistic" else 8.0 * _LOGIT * jnp.abs(q)
    return jnp.where(jnp.abs(z) < _TAIL, p * (1.0 - p) * rate / (1.0 - 2.0 * _REST), 0.0)


def _exponent(profile: str, q: Any) -> Any:
    """Argument z of the logistic 1 / (1 + e^-z) at a signed distance of q widths."""
    return q * (2.0 * _LOGIT) if profile == "logistic" else q * jnp.abs(q) * (4.0 * _LOGIT)
