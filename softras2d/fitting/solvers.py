"""Solvers from optimistix by name, set up for residuals that are known by products alone.

**Source:** Levenberg (1944) and Marquardt (1963) for the damping, Powell (1970) for the dogleg,
Kingma and Ba, *Adam* (ICLR 2015); Fong and Saunders, *LSMR* (SIAM J. Sci. Comput. 33(5), 2011), for
the linear systems.
"""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import lineax as lx
import optax
import optimistix as optx

Solver = optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser

_TRUST = 0.6
"""Share of the predicted fall above which the damping falls.

The 0.99 of optimistix is hardly ever reached where edges meet pixels, and damping never falls."""


class ByProducts(optx.AbstractGaussNewton):
    """A method of Gauss-Newton type that knows the Jacobian by its products alone."""

    rtol: float
    atol: float
    norm: Callable[[Any], Any] = eqx.field(static=True)
    descent: optx.AbstractDescent
    search: optx.ClassicalTrustRegion
    verbose: Callable[..., None] = eqx.field(static=True)

    def __init__(self, descent: optx.AbstractDescent, *, trust: float = _TRUST):
        self.rtol = self.atol = 0.0
        self.norm = optx.max_norm
        self.descent = descent
        self.search = optx.ClassicalTrustRegion(high_cutoff=trust)
        self.verbose = _silent


def levenberg_marquardt(products: int = 20, *, trust: float = _TRUST) -> ByProducts:
    """Levenberg-Marquardt with that many products of the Jacobian, and of its transpose, a step."""
    return ByProducts(optx.DampedNewtonDescent(linear_solver=_inner(products)), trust=trust)


def dogleg(products: int = 20, *, trust: float = _TRUST) -> ByProducts:
    """Powell's dogleg, likewise."""
    return ByProducts(optx.DoglegDescent(linear_solver=_inner(products)), trust=trust)


def _inner(products: int) -> lx.LSMR:
    # LSMR is safe in float32 where CG on the normal equations is not.
    return lx.LSMR(rtol=1e-6, atol=1e-6, max_steps=products)


def _silent(**_: Any) -> None:
    return None


def _adam(rate: float) -> optx.OptaxMinimiser:
    # The rate is held by the state, so that a host can let it fall.
    adam = optax.inject_hyperparams(optax.adam, static_args=_NUMBERS)(rate, b2=0.99)
    return optx.OptaxMinimiser(adam, rtol=0.0, atol=0.0)


_NUMBERS = ("b1", "b2", "eps", "eps_root", "mu_dtype", "nesterov")
"""Of Adam, but for its rate."""


SOLVERS: dict[str, Callable[[float], Solver]] = {
    "adam": _adam,
    "lm": lambda rate: levenberg_marquardt(),
    "dogleg": lambda rate: dogleg(),
    "bfgs": lambda rate: optx.BFGS(rtol=0.0, atol=0.0),
    "lbfgs": lambda rate: optx.LBFGS(rtol=0.0, atol=0.0),
}
"""Solvers by name, for a rate that those of first order take as the length of a step."""


def solver_of(solver: str | Solver, *, rate: float = 0.02) -> Solver:
    """A solver by name, or the one given; `ValueError` for anything else."""
    if isinstance(solver, optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser):
        return solver
    if not isinstance(solver, str) or solver not in SOLVERS:
        names = ", ".join(map(repr, SOLVERS))
        raise ValueError(
            f"`solver` must be an optimistix solver or one of {names}; got {solver!r:.60}."
        )
    return _by_name(solver, rate)


@functools.cache
def _by_name(solver: str, rate: float) -> Solver:
    # One object: optax makes new functions each time, for which programs would be compiled anew.
    return SOLVERS[solver](rate)
