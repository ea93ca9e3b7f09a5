"""The table of solvers, which are optimizers of optimistix, and how they are made.

The least-squares solvers use the Jacobian of the residual only in products with vectors, because
the Jacobian of an image is too large to be assembled.

**Source:** Levenberg (1944) and Marquardt (1963) for the damping, Powell (1970) for the dogleg,
Kingma and Ba, *Adam* (ICLR 2015); Fong and Saunders, *LSMR* (SIAM J. Sci. Comput. 33(5), 2011), for
the linear systems.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import lineax as lx
import optax
import optimistix as optx

Solver = optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser

_TRUST = 0.6
"""Fraction of the predicted decrease of the loss that a step must reach to be trusted more.

The next step then has less damping (Levenberg-Marquardt) or may be longer (dogleg). The default of
optimistix, 0.99, is hardly ever reached, because the residual is nonlinear wherever an edge crosses
a pixel. The damping would never fall."""


_PRODUCTS = 20
"""Maximum number of iterations of LSMR in one step.

Each takes one product with the Jacobian, and one with its transpose."""


class ByProducts(optx.AbstractGaussNewton):
    """A Gauss-Newton method that uses the Jacobian only in products with vectors.

    `descent`: computes a step, by Levenberg-Marquardt or by dogleg. The tolerances `rtol` and
    `atol`, to which optimistix compares the `norm` of a change, are 0, because the fit decides when
    to stop. `search` trusts steps more if they reach the fraction `_TRUST` of the predicted
    decrease, and `verbose` reports nothing.
    """

    rtol: float
    atol: float
    norm: Callable[[Any], Any] = eqx.field(static=True)
    descent: optx.AbstractDescent
    search: optx.ClassicalTrustRegion
    verbose: Callable[..., None] = eqx.field(static=True)

    def __init__(self, descent: optx.AbstractDescent):
        self.rtol = self.atol = 0.0
        self.norm = optx.max_norm
        self.descent = descent
        self.search = optx.ClassicalTrustRegion(high_cutoff=_TRUST)
        self.verbose = _silent


def levenberg_marquardt(products: int = _PRODUCTS) -> ByProducts:
    """Make a solver by the Levenberg-Marquardt method.

    Each step solves a linear problem by at most `products` iterations of LSMR, and uses the result
    as it is then. An iteration takes one product with the Jacobian, and one with its transpose.
    """
    return ByProducts(optx.DampedNewtonDescent(linear_solver=_inner(products)))


def dogleg(products: int = _PRODUCTS) -> ByProducts:
    """Make a solver by Powell's dogleg method, with `products` as in `levenberg_marquardt`."""
    return ByProducts(optx.DoglegDescent(linear_solver=_inner(products)))


def _inner(products: int) -> lx.LSMR:
    """Make the iterative solver for the linear least-squares problem of each step.

    `products`: the maximum number of its iterations. Each takes one product with the Jacobian, and
    one with its transpose.
    """
    # LSMR is safe in float32 where CG on the normal equations is not.
    return lx.LSMR(rtol=1e-6, atol=1e-6, max_steps=products)


def _silent(**_: Any) -> None:
    """Ignore what optimistix reports about a step."""


def _adam(learning_rate: float) -> optx.OptaxMinimiser:
    """Make Adam, with an initial learning rate that `solve.set_learning_rate` can change later.

    Both of its tolerances are 0, so it never ends by itself: the fit decides when to stop.
    """
    # The state holds the learning rate, so that the host can lower it without compiling again.
    adam = optax.inject_hyperparams(optax.adam, static_args=_FIXED)(learning_rate, b2=0.99)
    return optx.OptaxMinimiser(adam, rtol=0.0, atol=0.0)


_FIXED = ("b1", "b2", "eps", "eps_root", "mu_dtype", "nesterov")
"""Adam's hyperparameters other than the learning rate, which changes during a fit."""


class NamedSolver(NamedTuple):
    """A row of `SOLVERS`, the table of optimizers that the option `solver` can name.

    - `make`: function that makes the solver. Its argument is a learning rate, which only Adam uses.
    - `adjustable_rate`: whether a fit may lower the learning rate between chunks of steps, by
      `solve.set_learning_rate`. Such a solver must come from optax. Whatever its state remembers of
      earlier points must be arrays with one number per unknown, because a fit of layers reorders
      the entries of these arrays together with its triangles.
    """

    make: Callable[[float], Solver]
    adjustable_rate: bool


SOLVERS: dict[str, NamedSolver] = {
    "adam": NamedSolver(_adam, adjustable_rate=True),
    "lm": NamedSolver(lambda learning_rate: levenberg_marquardt(), adjustable_rate=False),
    "dogleg": NamedSolver(lambda learning_rate: dogleg(), adjustable_rate=False),
    "bfgs": NamedSolver(lambda learning_rate: optx.BFGS(rtol=0.0, atol=0.0), adjustable_rate=False),
    "lbfgs": NamedSolver(
        lambda learning_rate: optx.LBFGS(rtol=0.0, atol=0.0), adjustable_rate=False
    ),
}
"""The solver for each name that the option `solver` accepts."""


def is_rate_adjustable(solver: str | Solver) -> bool:
    """Whether a fit may lower the solver's learning rate between chunks of steps.

    `solver` is a name from `SOLVERS`, or a solver object. For an object the answer is False.
    """
    return isinstance(solver, str) and SOLVERS[solver].adjustable_rate


def solver_of(solver: str | Solver, *, learning_rate: float = 0.02) -> Solver:
    """Return the solver with a given name, or the given solver object itself.

    `learning_rate`: the first learning rate of Adam; no other solver uses it. Raises `ValueError`
    for anything but a name from `SOLVERS` or a solver object of optimistix.
    """
    if isinstance(solver, optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser):
        return solver
    if not isinstance(solver, str) or solver not in SOLVERS:
        names = ", ".join(map(repr, SOLVERS))
        raise ValueError(
            f"`solver` must be an optimistix solver or one of {names}; got {solver!r:.60}."
        )
    return _cached_solver(solver, learning_rate)


@functools.cache
def _cached_solver(solver: str, learning_rate: float) -> Solver:
    """Make the solver that a name from `SOLVERS` stands for, once for each set of arguments."""
    # Cached, because optax makes new functions at each call, and each would be compiled anew.
    return SOLVERS[solver].make(learning_rate)
