"""Integers of more than 32 bits, as a wrapped 32-bit integer beside a float32 estimate.

Edge values (`fixed_point`) need up to 43 bits. Neither number determines a value alone: the wrapped
integer lacks a multiple of 2^32, and the float lacks the last digits. Together they determine it.
Only this module combines the two numbers. Written for numpy and jax arrays alike.
"""

from typing import NamedTuple

from ..numerics.array_types import DTypeLike, HostOrDeviceArray

LARGE_ESTIMATE = 2**30
"""Estimates of this absolute size or more have the sign of the `WrappedValue` they belong to."""


class WrappedValue(NamedTuple):
    """Integers of more than 32 bits, each kept as two numbers that together determine it.

    - `wrapped`: the value modulo 2^32, as int32. Sums and products of it wrap, which is correct.
    - `estimate`: the value as float32, with an error below 2^29.

    **Why the parts are enough.** Where the estimate is below 2^30 in size, the value is below
    2^30 + 2^29 in size, so that it fits 32 bits and equals `wrapped`. Elsewhere the value is above
    2^30 - 2^29 in size, and has the sign of the estimate. As the error is below 2^31, the estimate
    also determines the multiple of 2^32 that `wrapped` lacks, and thus the value itself.

    **Why the bound holds.** The estimate of one edge value errs by less than 2^20 at every sample
    of the canvas (`fixed_point`), the sum over the at most 256 samples of a pixel by less than
    2^28, and twice the area, a sum of three edge values, by less than 2^22.
    """

    wrapped: HostOrDeviceArray
    estimate: HostOrDeviceArray

    def moved(self, *moves: tuple[HostOrDeviceArray, HostOrDeviceArray]) -> "WrappedValue":
        """Add `step * count` to the value, for each of the given pairs `(step, count)`.

        Steps and counts are integers below 2^24 in size.
        """
        wrapped, estimate = self
        f32 = estimate.dtype
        for step, count in moves:
            wrapped = wrapped + step * count
            estimate = estimate + step.astype(f32) * count.astype(f32)
        return WrappedValue(wrapped, estimate)

    def times(self, count: HostOrDeviceArray) -> "WrappedValue":
        """Multiply the value by an integer `count`, 0..256."""
        return WrappedValue(count * self.wrapped, count.astype(self.estimate.dtype) * self.estimate)

    @property
    def is_near_zero(self) -> HostOrDeviceArray:
        """Whether the estimate is below 2^30 in size, so that `wrapped` is the value itself."""
        xp = self.estimate.__array_namespace__()
        return xp.abs(self.estimate) < float(LARGE_ESTIMATE)

    def is_inside(self, remainder: HostOrDeviceArray | None = None) -> HostOrDeviceArray:
        """Whether the value is 0 or more, which for an edge value means inside the edge.

        `remainder` is a float in 0..256 that is added to the value before the test; None adds
        nothing.
        """
        xp = self.estimate.__array_namespace__()
        exact = self.wrapped
        if remainder is not None:
            # The sign is right although the float may round the integer: one that does not fit a
            # float is larger than any remainder.
            exact = exact.astype(self.estimate.dtype) + remainder
        return xp.where(self.is_near_zero, exact >= 0, self.estimate > 0)

    def sign(self) -> HostOrDeviceArray:
        """The sign of the value as int32: -1, 0 or 1."""
        xp = self.estimate.__array_namespace__()
        far = xp.sign(self.estimate).astype(self.wrapped.dtype)
        return xp.where(self.is_near_zero, xp.sign(self.wrapped), far)

    def clamped(self) -> HostOrDeviceArray:
        """The value as int32 where it is near zero (`is_near_zero`), elsewhere +-2^30 by its sign.

        From a tile's first sample to any other sample of the tile, an edge value changes by less
        than 34 |dy| + 31 |dx| < 2^30, where (dx, dy) is the vector along the edge (`fixed_point`).
        So clamping it at the first sample does not change its sign at any sample of the tile.
        """
        xp = self.estimate.__array_namespace__()
        far = xp.where(self.estimate > 0, LARGE_ESTIMATE, -LARGE_ESTIMATE).astype(xp.int32)
        return xp.where(self.is_near_zero, self.wrapped, far)

    def split(self) -> tuple[HostOrDeviceArray, HostOrDeviceArray]:
        """Split each value into an int32, about 2^30 at most in size, and a multiple of 2^31.

        The multiple is a float32, and the sum of the two numbers is the value. If the value is an
        edge value at a tile's first sample, the steps to any sample of the tile can be added to the
        int32 without wrapping, because they add up to less than 2^30 (`clamped`).
        """
        xp = self.estimate.__array_namespace__()
        number = xp.round(self.estimate * 2.0**-31)
        is_odd = number.astype(xp.int32) & 1
        # Adding 2^31 modulo 2^32 changes the highest bit.
        return self.wrapped ^ (is_odd << 31), number * 2.0**31

    def to_float(self, dtype: DTypeLike) -> HostOrDeviceArray:
        """Convert the value to a float of `dtype`.

        The value is rounded at most three times, and only once if it is below 2^31 in size. In
        float64 the result is exact.
        """
        xp = self.estimate.__array_namespace__()
        difference = self.estimate - self.wrapped.astype(self.estimate.dtype)
        multiple = xp.round(difference * 2.0**-32)
        return self.wrapped.astype(dtype) + multiple.astype(dtype) * 2.0**32
