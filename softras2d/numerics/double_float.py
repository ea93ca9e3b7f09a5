"""Double-float arithmetic, in which a number is a pair of floats, for twice their precision.

The value of a pair (high, low) is the exact sum of its two floats, and `low` is at most half a unit
in the last place of `high`. Relative errors are about 2^-44 for float32; those of a sum or a
difference are relative to its larger term. All this, and what is called exact below, holds as long
as nothing overflows or underflows. Written for numpy and jax arrays alike.

Products split their factors, and the split of a large factor would overflow. So everything that
multiplies (`product_of`, `multiply`, `divide`, `cross`) takes numbers below 2^100 in size.

XLA may contract a product and a sum into one operation with one rounding. Every formula here stays
correct to that precision with or without it.

**Source:** Dekker, *A floating-point technique for extending the available precision* (Numerische
Mathematik 18, 1971), sections 4 and 5.
"""

from typing import Any

import numpy as np

Pair = tuple[Any, Any]
"""A number as (high, low): the nearest float, and the rest."""

Point = tuple[Pair, Pair]
"""The coordinates x and y of a point or a vector, each a double float."""


def pair_of(x: Any) -> Pair:
    """Make the pair (`x`, 0), whose value is exactly the float `x`."""
    xp = x.__array_namespace__()
    return x, xp.zeros_like(x)


def sum_of(a: Any, b: Any) -> Pair:
    """Compute the exact sum of two floats, of any relative size, as a pair (high, low)."""
    high = a + b
    rounded_b = high - a
    return high, (a - (high - rounded_b)) + (b - rounded_b)


def product_of(a: Any, b: Any) -> Pair:
    """Compute the exact product of two floats, as a pair (high, low).

    Both factors must be below 2^100 in size.
    """
    high = a * b
    (a_high, a_low), (b_high, b_low) = _halves(a), _halves(b)
    low = ((a_high * b_high - high) + a_high * b_low + a_low * b_high) + a_low * b_low
    return high, low


def add(a: Pair, b: Pair) -> Pair:
    """Add two numbers, each a pair (high, low) of floats, to double-float precision."""
    high, low = sum_of(a[0], b[0])
    return _normalized(high, low + (a[1] + b[1]))


def subtract(a: Pair, b: Pair) -> Pair:
    """Subtract `b` from `a`, each a pair (high, low) of floats, to double-float precision."""
    return add(a, (-b[0], -b[1]))


def multiply(a: Pair, b: Pair) -> Pair:
    """Multiply two numbers, each a pair (high, low) of floats, to double-float precision.

    Both must be below 2^100 in size.
    """
    high, low = product_of(a[0], b[0])
    return _normalized(high, low + (a[0] * b[1] + a[1] * b[0]))


def divide(a: Pair, b: Pair) -> Pair:
    """Divide `a` by `b`, each a pair (high, low) of floats, to double-float precision.

    The `high` of `b` must not be zero. Divisor and quotient must be below 2^100 in size, because
    the remainder is computed from their product.
    """
    high = a[0] / b[0]
    remainder = subtract(a, multiply(pair_of(high), b))
    return _normalized(high, remainder[0] / b[0])


def cross(a: Point, b: Point) -> Pair:
    """Compute the cross product a_x b_y - a_y b_x of two vectors, to double-float precision.

    Coordinates are pairs (high, low) of floats, below 2^100 in size.
    """
    return subtract(multiply(a[0], b[1]), multiply(a[1], b[0]))


def scale(a: Pair, power_of_two: Any) -> Pair:
    """Multiply a pair (high, low) by a power of two; the result is exact."""
    return a[0] * power_of_two, a[1] * power_of_two


def choose(condition: Any, a: Pair, b: Pair) -> Pair:
    """Select the pairs of `a` where the condition is true, else the pairs of `b`."""
    xp = condition.__array_namespace__()
    return xp.where(condition, a[0], b[0]), xp.where(condition, a[1], b[1])


def _normalized(high: Any, low: Any) -> Pair:
    """Make the pair whose value is the sum of the floats `high` and `low`.

    The `high` of the result is this sum rounded to a float, and its `low` the rounding error. The
    argument `low` must not be larger in size than the argument `high`.
    """
    total = high + low
    return total, low - (total - high)


def _halves(x: Any) -> Pair:
    """Split x into two floats, each with at most half of its digits, whose sum is exactly x."""
    digits = np.finfo(x.dtype).nmant + 1
    spread = x * (2.0 ** (digits - digits // 2) + 1.0)
    high = spread - (spread - x)
    return high, x - high
