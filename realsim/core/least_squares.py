"""Damped, robust nonlinear least squares: one loop for vectors and for poses, dense and sparse.

    cost(x) = sum_g rho(|r_g(x)|^2) + sum_k ((x_k - mean_k) / sigma_k)^2

Levenberg-Marquardt with iterated weights (Triggs et al. 2000, sections 4.3 and 6). `scipy.optimize.least_squares` has
the same optimum (tests/core/test_least_squares.py) but knows neither poses, whose steps do not add, nor a loss of
several residuals together, nor exact solutions of sparse systems.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from realsim.core.types import F64

State = TypeVar("State")
Loss = Callable[[F64], tuple[float, F64]]
"""Residuals (M,) -> cost and weights (M,)."""
Model = Callable[[State], tuple[F64, Any] | None]
"""A state -> residuals (M,) in standard deviations, NaN where one is unknown, and their Jacobian (M, P): an array, a
scipy.sparse matrix, or a function that makes it when it is needed. None where the state is impossible."""

TRIES = 6
"""Times that damping is raised tenfold before a step is given up."""
LEAST_DAMPING = 1e-9
"""Share of the diagonal below which damping changes no step in double precision; nothing was tuned for it."""


def squares(residual: F64) -> tuple[float, F64]:
    """The loss of Gaussian noise."""
    return float(residual @ residual), np.ones_like(residual)


def cauchy(scale: float, groups: NDArray[np.int64] | None = None) -> Loss:
    """Half the weight at `scale` standard deviations: rho(s) = scale^2 log(1 + s / scale^2).

    Args:
        groups: (M,) rows of the same number are an outlier together, or not at all; None: each by itself.
    """

    def loss(residual: F64) -> tuple[float, F64]:
        s = residual**2 if groups is None else np.bincount(groups, residual**2).astype(float)
        cost = scale**2 * float(np.log1p(s / scale**2).sum())
        weight = 1 / (1 + s / scale**2)
        return cost, weight if groups is None else weight[groups]

    return loss


@dataclass(frozen=True)
class Minimum(Generic[State]):
    """A state, and the model there."""

    state: State
    moved: F64 | float
    """(P,) sum of the steps since the start."""
    residual: F64
    """(M,), 0 where unknown."""
    weight: F64
    """(M,) of the loss, 0 where a residual or its Jacobian is unknown."""
    jacobian: Any
    """(M, P)."""
    cost: float
    iterations: int = 0

    @property
    def information(self) -> Any:
        """(P, P) J' W J, without the prior."""
        return self.jacobian.T @ _rows(self.jacobian, self.weight)


class Normal:
    """Symmetric positive equations A x = b, solved once and used often. Dense or sparse; of a sparse one the last
    `eliminated` unknowns may be blocks of three that do not meet each other (points), which the Schur complement takes
    out first."""

    def __init__(self, A: Any, eliminated: int = 0) -> None:
        from scipy.sparse import bsr_matrix, csc_matrix, issparse
        from scipy.sparse.linalg import splu

        self.kept = A.shape[0] - eliminated
        """Unknowns that are not eliminated; `solve_kept` solves for them with nothing on the others' right side."""
        self.inner_inverse: F64 = np.zeros((0, 3, 3))
        """(eliminated / 3, 3, 3) inverses of the eliminated blocks."""
        if not issparse(A):
            self.solve_kept: Callable[[F64], F64] = lambda b: np.asarray(np.linalg.solve(A, b))
            return
        A = A.tocsr()
        S = A[: self.kept, : self.kept]
        if eliminated:
            count = eliminated // 3
            self._across = A[: self.kept, self.kept :]
            row, column = A[self.kept :, self.kept :].nonzero()
            blocks = np.zeros((count, 3, 3))
            blocks[row // 3, row % 3, column % 3] = np.asarray(A[self.kept + row, self.kept + column]).ravel()
            self.inner_inverse = np.asarray(np.linalg.inv(blocks), float)
            self._inner = bsr_matrix(
                (self.inner_inverse, np.arange(count), np.arange(count + 1)), shape=(eliminated, eliminated)
            )
            S = S - self._across @ (self._inner @ self._across.T)
        options = {"SymmetricMode": True}
        self.solve_kept = splu(csc_matrix(S), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).solve

    def solve(self, b: F64) -> F64:
        """x (P,) or (P, K) for b of the same shape."""
        if not len(self.inner_inverse):
            return self.solve_kept(b)
        top, low = b[: self.kept], b[self.kept :]
        x = self.solve_kept(top - self._across @ (self._inner @ low))
        return np.concatenate([x, self._inner @ (low - self._across.T @ x)])


def least_squares(
    model: Model[State],
    start: State,
    *,
    move: Callable[[State, F64], State] = np.add,  # type: ignore[assignment]
    loss: Loss = squares,
    prior: tuple[F64, F64] | None = None,
    bounds: tuple[F64, F64] | None = None,
    free: NDArray[np.bool_] | None = None,
    eliminated: int = 0,
    damping: float = 1e-4,
    lengths: Sequence[float] = (1.0,),
    iterations: int = 30,
    tolerance: float = 1e-8,
    least_gain: float = 1e-6,
) -> Minimum[State] | None:
    """The state near `start` that costs least; None where `start`, or without damping a later state, is impossible.

    Args:
        move: (state, step (P,)) -> state; the Jacobian is by this step. Sums are for vectors.
        prior: (P,) how far the start is from the prior's mean, and (P,) its standard deviations (infinity: none).
        bounds: (P,) each, of vectors.
        free: (P,) which unknowns may move.
        eliminated: last unknowns of a sparse model that are three a point (see `Normal`).
        damping: of the first step, relative to the diagonal; 0: plain Gauss-Newton, every step is taken: for models
            whose rows change on the way, so that costs are not comparable.
        lengths: multiples of a step that are tried, the cheapest is taken: above 1 where noise shortens steps.
        iterations: most of them.
        tolerance: largest change of an unknown at which it is done.
        least_gain: relative gain at which a damped search is done.
    """
    precision: Any = None if prior is None else prior[1] ** -2.0

    def look(state: State, moved: F64 | float) -> Minimum[State] | None:
        if (found := model(state)) is None:
            return None
        known = np.isfinite(found[0])
        r = np.where(known, found[0], 0)
        cost, weight = loss(r)
        # Rows that are unknown here may be known elsewhere: they cost what the others do on average.
        cost *= len(r) / max(int(known.sum()), 1)
        if prior is not None:
            cost += float(np.sum(np.square((moved + prior[0]) / prior[1])))
        return Minimum(state, moved, r, weight * known, found[1], cost)

    def stepped(at: Minimum[State], step: F64) -> Minimum[State] | None:
        state: Any = move(at.state, step)
        if bounds is None:
            return look(state, at.moved + step)
        inside: Any = np.clip(state, *bounds)
        return look(inside, at.moved + (inside - at.state))

    def equations(at: Minimum[State]) -> Callable[[float], F64]:
        JW = _rows(at.jacobian, at.weight)
        H, g = at.jacobian.T @ JW, JW.T @ at.residual
        if prior is not None:
            H, g = _raised(H, precision), g + precision * (at.moved + prior[0])
        may: Any = np.ones(len(g), bool) if free is None else free
        if bounds is not None:
            may = may & ~(((at.state <= bounds[0]) & (g > 0)) | ((at.state >= bounds[1]) & (g < 0)))  # type: ignore[operator]
        diagonal = H.diagonal()
        # Far below every real constraint, so that an unknown which nothing speaks of cannot make it singular.
        ridge = 1e-9 * float(diagonal[may].mean()) if may.any() else 0.0

        def step(damping: float) -> F64:
            out, moves = np.zeros(len(g)), may
            while True:
                which = np.flatnonzero(moves)
                inner, right = (H[which][:, which], (g + H @ out)[which]) if len(which) < len(g) else (H, g)
                found = -Normal(_raised(inner, damping * diagonal[which] + ridge), eliminated).solve(right)
                x: Any = at.state
                crosses = np.zeros(len(which), bool)
                if bounds is not None:
                    low, high = bounds[0][which] - x[which], bounds[1][which] - x[which]
                    crosses = (found < low) | (found > high)
                    # Who would cross a bound goes as far as that, and the others are solved for again.
                    found = np.clip(found, low, high)
                if not crosses.any():
                    out[which] = found
                    return out
                out[which[crosses]] = found[crosses]
                moves = moves & ~np.isin(np.arange(len(g)), which[crosses])

        return step

    here, done = look(start, 0.0), 0
    while here is not None and done < iterations:
        done, before = done + 1, _linearised(here)
        solve = equations(before)
        for _ in range(TRIES if damping else 1):
            step = solve(damping)
            tries = [there for k in lengths if (there := stepped(before, k * step)) is not None]
            here = min(tries, key=lambda there: there.cost, default=None)
            if not damping or (here is not None and here.cost < before.cost):
                break
            damping *= 10
        else:
            here = before
            break
        small = np.abs(step).max(initial=0) < tolerance
        if small or (damping and here is not None and before.cost - here.cost <= least_gain * before.cost):
            break
        damping = max(damping / 10, LEAST_DAMPING) if damping else 0.0
    return None if here is None else replace(_linearised(here), iterations=done)


def _linearised(at: Minimum[State]) -> Minimum[State]:
    """With its Jacobian made, and without weight where that is unknown."""
    J = at.jacobian() if callable(at.jacobian) else at.jacobian
    if not isinstance(J, np.ndarray):
        return replace(at, jacobian=J)
    known = np.atleast_1d(np.isfinite(J).all(axis=1))
    return replace(at, jacobian=np.where(known[:, None], J, 0), weight=at.weight * known)


def _rows(J: Any, weight: F64) -> Any:
    """J with its rows times `weight`."""
    return J * weight[:, None] if isinstance(J, np.ndarray) else J.multiply(weight[:, None]).tocsr()


def _raised(H: Any, diagonal: F64) -> Any:
    from scipy.sparse import diags_array

    return H + (np.diag(diagonal) if isinstance(H, np.ndarray) else diags_array(diagonal))


def differences(
    residual: Callable[[F64], F64 | None], steps: F64
) -> Callable[[F64], tuple[F64, Callable[[], F64]] | None]:
    """The model of a residual without a Jacobian: central differences of these steps (P,), made when needed."""

    def model(x: F64) -> tuple[F64, Callable[[], F64]] | None:
        r = residual(x)
        if r is None:
            return None

        def jacobian() -> F64:
            columns = []
            for k, h in enumerate(steps):
                side = h * (np.arange(len(x)) == k)
                up, down = residual(x + side), residual(x - side)
                unknown = up is None or down is None
                columns.append(np.full(len(r), np.nan) if unknown else (up - down) / (2 * h))  # type: ignore[operator]
            return np.stack(columns, axis=1)

        return r, jacobian

    return model
