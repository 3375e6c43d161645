"""The linear picture: normal equations of a residual, small deviations integrated out, the evidence of a cause."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from realsim.core.types import F64
from realsim.gap import figures


@dataclass
class Evidence:
    """Normal equations over atoms, a run each, of the residual about some simulator."""

    A: list[F64]
    b: list[F64]
    c: list[float]
    version: int = -1
    """Of the weights; -1 if they are nobody's."""
    runs: tuple[int, ...] = ()
    """Positions among the screened runs."""
    centre: F64 | float = 0.0
    """(p,) what the small deviations scatter about; their coordinates count from there."""

    def moved(self, shift: F64) -> Evidence:
        """The same with the centre elsewhere: r - G shift takes the place of r."""
        pairs = list(zip(self.A, self.b, strict=True))
        b = [b - A @ shift for A, b in pairs]
        c = [c + float(shift @ A @ shift - 2 * b @ shift) for c, (A, b) in zip(self.c, pairs, strict=True)]
        return Evidence(self.A, b, c, self.version, self.runs, self.centre + shift)

    def looks(self) -> list[Evidence]:
        """With all runs, and with the better half of them (least trimmed squares; Rousseeuw, J. Am. Stat. Assoc. 79,
        1984). Where a foot trips or a drive saturates in some runs, and in their repeats, slopes hold for next to
        nothing, and would hide what the others say."""
        better = np.argsort(self.c)[: (len(self.c) + 1) // 2]
        return [self, self.of(sorted(better.tolist()))] if len(self.c) > 1 else [self]

    def of(self, runs: list[int]) -> Evidence:
        """The runs at these positions."""
        A, b, c = [self.A[i] for i in runs], [self.b[i] for i in runs], [self.c[i] for i in runs]
        return Evidence(A, b, c, self.version, tuple(self.runs[i] for i in runs), self.centre)

    def without(self, k: int) -> Evidence:
        """All runs but the one at this position; that one, where there is no other."""
        return self.of([i for i in range(len(self.c)) if i != k] or [k])


def posterior(A: F64, prior: F64) -> F64:
    """Covariance of x for r = G x + e with standard deviations `prior` (0: the atom is absent)."""
    there, found = np.flatnonzero(prior), np.zeros_like(A)
    square, D = np.ix_(there, there), prior[there, None]
    found[square] = D * np.linalg.solve(np.eye(len(there)) + D * A[square] * prior[there], np.diag(prior[there]))
    return found


def bounded(A: F64, b: F64, prior: F64, most: F64 | float) -> tuple[F64, F64]:
    """(most probable x with |x| <= `most`, standard deviations `prior` without those that lie on their bound).

    Beside a large gap, a Gaussian alone would let many small deviations grow to absurd values, and hide the one cause
    that explains it. Primal-dual active set (Hintermueller, Ito and Kunisch, SIAM J. Optim. 13, 2003): what exceeds its
    bound is held there, what would come back from it is free again, until a set of bounds comes a second time.
    """
    x, held, seen = np.zeros(len(b)), np.zeros(len(b), bool), set[bytes]()
    while held.tobytes() not in seen:
        seen.add(held.tobytes())
        free = (prior > 0) & ~held
        scale, rest = prior[free], b[free] - A[np.ix_(free, ~free)] @ x[~free]
        inner = np.eye(len(scale)) + scale[:, None] * A[np.ix_(free, free)] * scale
        x[free] = scale * np.linalg.solve(inner, scale * rest)
        pull = b - A @ x - np.divide(x, prior**2, out=np.zeros(len(x)), where=prior > 0)
        now = np.where(held, pull * x > 0, free & (np.abs(x) > most))
        x, held = np.where(now, np.copysign(most, x), x), now
    return np.clip(x, -most, most), np.where(held, 0.0, prior)


@dataclass(frozen=True)
class Spectrum:
    """Of the information on small deviations, in units of their prior: what it says of a scale that they share."""

    values: F64
    """(m,) eigenvalues, of the atoms that are there."""
    basis: F64
    """(p, m) columns: eigenvectors."""

    @staticmethod
    def of(A: F64, prior: F64) -> Spectrum:
        there = np.flatnonzero(prior)
        values, vectors = np.linalg.eigh(prior[there, None] * A[np.ix_(there, there)] * prior[there])
        basis = np.zeros((len(prior), len(there)))
        basis[there] = vectors
        return Spectrum(np.maximum(values, 0.0), basis)

    def occam(self, scale: float) -> float:
        """Nats that priors of `scale` times their size cost more than those of their full size do (below 0: less), by
        the volume that they give to what the data determine."""
        return 0.5 * float(np.log((1 + scale**2 * self.values) / (1 + self.values)).sum())

    def free(self, b: F64, prior: F64, scale: float) -> F64:
        """(p,) the most probable x at a scale, with no bounds."""
        known = self.basis.T @ (scale * prior * b)
        return np.asarray(scale * prior * (self.basis @ (known / (1 + scale**2 * self.values))))

    def least(self, b: F64, c: float, prior: F64, scale: float) -> float:
        """Misfit and cost at a scale, with no bounds."""
        square = (self.basis.T @ (prior * b)) ** 2
        return 0.5 * float(c - (scale**2 * square / (1 + scale**2 * self.values)).sum()) + self.occam(scale)


def scaled(A: F64, b: F64, c: float, prior: F64, spectrum: Spectrum | None = None) -> tuple[float, float]:
    """(misfit, scale) at the most probable scale that all small deviations of this robot share.

    Robots differ in how far they are from their model as a whole: one that needs hardly any deviation once a cause is
    named has that cause, one that needs many at once to do without it has not (empirical Bayes; MacKay, Neural
    Computation 4, 1992). `spectrum`: of A and prior, where it is known already.
    """
    best, spectrum = (np.inf, 1.0), spectrum or Spectrum.of(A, prior)
    for least, s in sorted((spectrum.least(b, c, prior, s), s) for s in figures.SCALES):
        if least < best[0]:
            x, most = spectrum.free(b, prior, s), figures.REASONABLE * s * prior
            if (np.abs(x) > most).any():
                x = bounded(A, b, s * prior, most)[0]
            best = min(best, (misfit_at(A, b, c, x, s * prior) + spectrum.occam(s), s))
    return best


def misfit_at(A: F64, b: F64, c: float, x: F64, prior: F64) -> float:
    """Half the weighted squared residual beside small deviations x, and their price."""
    z = np.divide(x, prior, out=np.zeros(len(x)), where=prior > 0)
    return 0.5 * float(c - 2 * b @ x + x @ A @ x + z @ z)


def marginal(evidence: Evidence, prior: F64, most: F64 | float) -> tuple[F64, F64, float]:
    """(A~, b~, J): information and score of any extra direction once the nuisances are marginalised, none of them
    beyond `most`, and the misfit."""
    A, b = np.sum(evidence.A, axis=0), np.sum(evidence.b, axis=0)
    x, free = bounded(A, b, prior, most)
    cov = posterior(A, free)
    return A - A @ cov @ A, b - A @ x, misfit_at(A, b, sum(evidence.c), x, prior)


def log_evidence(A: F64, b: F64, directions: F64, size: F64) -> tuple[F64, F64]:
    """(log evidence gain, estimate) of parameters along `directions` with prior sizes `size`; of each of (..., N, N)
    and (..., N)."""
    rows = np.flatnonzero(directions.any(axis=1))
    if len(rows) <= 2:  # else sums may end in another last digit
        A, b, directions = np.ascontiguousarray(A[..., rows[:, None], rows]), b[..., rows], directions[rows]
    info = directions.T @ A @ directions
    s = directions.T @ b[..., None]
    estimate = np.linalg.solve(info + np.diag(1 / size**2), s)
    occam = 0.5 * np.linalg.slogdet(np.eye(len(size)) + (size[:, None] * info) * size)[1]
    return (0.5 * s.mT @ estimate)[..., 0, 0] - occam, np.asarray(estimate[..., 0])
