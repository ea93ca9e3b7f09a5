"""Passes: functions that the compiler keeps apart.

XLA on the CPU fuses an elementwise producer into every consumer and computes it again for each
element that reads it; between two passes that each fill memory once, that multiplies the work
(about fivefold for a hard render). It honours no optimisation barrier there, but it does keep a
call that is marked as not to be inlined.
"""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import jax
from jax.experimental.xla_metadata import set_xla_metadata

P = ParamSpec("P")
R = TypeVar("R")


def materialized(function: Callable[P, R], **jit_options) -> Callable[P, R]:
    """`function`, compiled apart on the CPU: what it returns is in memory before others read it.

    On other devices, whose fusion weighs recomputation, it is the plain function.
    """

    def body(*args: P.args, **kwargs: P.kwargs) -> R:
        # The mark below reaches every call traced within; theirs is taken off again.
        with set_xla_metadata(inlineable="true"):
            return function(*args, **kwargs)

    compiled = jax.jit(functools.wraps(function)(body), **jit_options)

    @functools.wraps(function)
    def apart(*args: P.args, **kwargs: P.kwargs) -> R:
        if jax.default_backend() != "cpu":
            return function(*args, **kwargs)
        with set_xla_metadata(inlineable="false"):
            return compiled(*args, **kwargs)

    return apart
