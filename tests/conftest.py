"""Settings and fixtures for all tests: strict JAX types, quick compilation, seeded hypothesis."""

import contextlib
import gc
import os
from collections.abc import Callable, Iterator

import hypothesis
import jax
import jax.monitoring
import pytest

from softras2d.numerics.compiled_programs import drop_programs

if os.environ.get("SOFTRAS2D_OPTIMIZED_TESTS", "0") == "0":
    # Most tests run a program once, and compiling it with little optimization takes a third of the
    # time. CI repeats the tests that measure roundings or compare bits as users' programs compile.
    # XLA reads the flags when JAX first uses a device. If one is given twice, the last counts.
    os.environ["XLA_FLAGS"] = (
        "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false"
        f" --xla_cpu_parallel_codegen_split_count=1 {os.environ.get('XLA_FLAGS', '')}"
    ).strip()

jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

# Tracing makes many long-lived objects and few reference cycles. Running the cycle collector less
# often saves a tenth of the time.
gc.set_threshold(100_000, 50, 100)

# It provides the fixture `assert_image_matches` and the option `--update-references`.
pytest_plugins = ["softras2d.testing.plugin"]

# Examples are the same on every machine. There is no deadline, since a first example compiles.
hypothesis.settings.register_profile(
    "softras2d", derandomize=True, deadline=None, database=None, max_examples=25
)
hypothesis.settings.load_profile("softras2d")


_MAX_MAPS = 4000
"""Number of memory maps of a process above which its compiled programs are dropped.

The process then stays below about 2.5 GB. With the default of `drop_programs` it grew to 7 GB in
the slow tests, and a test at the end took up to thirty times as long as it does alone.
"""


@pytest.fixture(autouse=True)
def _drop_programs() -> Iterator[None]:
    """Drop compiled programs after a test, before they slow down the tests after it."""
    yield
    drop_programs(_MAX_MAPS)


@pytest.fixture
def float64() -> Iterator[None]:
    """Enable 64-bit types in JAX during a test, for comparisons with tight tolerances."""
    with jax.enable_x64(True):
        yield


class Compilations:
    """Names of the functions that XLA compiled while counting."""

    def __init__(self):
        self.names: list[str] = []

    def __len__(self) -> int:
        return len(self.names)

    def listen(self, event: str, duration_secs: float, **details: str | int) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            self.names.append(str(details.get("fun_name", "?")))


@pytest.fixture
def count_compilations() -> Callable[[], contextlib.AbstractContextManager[Compilations]]:
    """Record what XLA compiles: `with count_compilations() as compiled: ...`."""

    @contextlib.contextmanager
    def count() -> Iterator[Compilations]:
        compiled = Compilations()
        jax.monitoring.register_event_duration_secs_listener(compiled.listen)
        try:
            yield compiled
        finally:
            jax.monitoring.unregister_event_duration_listener(compiled.listen)

    return count
