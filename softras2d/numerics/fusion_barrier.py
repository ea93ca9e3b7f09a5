"""A barrier against fusion: functions whose results are written to memory before they are read.

XLA's CPU compiler fuses an elementwise computation into every computation that reads its result,
and then repeats it for each element that is read. A chain of such steps repeats the first of them
many times over: without the barriers of this package a hard render does about five times the work.

`jax.lax.optimization_barrier` does not help. The CPU compiler removes it before it fuses (seen with
JAX 0.10.2). It does keep a call whose metadata say `inlineable="false"`, and fuses on either side
of the call only. `tests/numerics/test_fusion_barrier.py` compiles a chain of two steps in each of
these ways and looks whether one fused computation holds both. If its test of chains without the
barrier fails with a later JAX, the barriers should be measured again.
"""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import jax
from jax.experimental.xla_metadata import set_xla_metadata

P = ParamSpec("P")
R = TypeVar("R")


def materialized(function: Callable[P, R], **jit_options) -> Callable[P, R]:
    """Wrap `function` so that on the CPU its results are written to memory before they are read.

    On the CPU the wrapped function is compiled as a call of its own, inside which fusion goes on as
    usual. On other devices the compiler weighs the cost of repeating work, and `function` is called
    as it is. The device is JAX's default backend at the time of the call. Values and derivatives
    are those of `function`. `jit_options` are passed to `jax.jit`, such as `static_argnames`; they
    have no effect on other devices.
    """

    def call_inside(*args: P.args, **kwargs: P.kwargs) -> R:
        # Metadata reach every call that is traced within: inner calls may be inlined again.
        with set_xla_metadata(inlineable="true"):
            return function(*args, **kwargs)

    compiled = jax.jit(functools.wraps(function)(call_inside), **jit_options)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        if jax.default_backend() != "cpu":
            return function(*args, **kwargs)
        with set_xla_metadata(inlineable="false"):
            return compiled(*args, **kwargs)

    return call
