"""A linear model with Gaussian priors whose groups may err: estimates, and evidence that a parameter is not everyday.

y = A x + u[group] + noise. Every x has a prior N(0, s^2); u is one error a group with Student's t (a few groups that
err much do not matter); sizes of u and of the noise are estimated. Whether a parameter is larger than an everyday
deviation is a comparison of two priors for it, with all else integrated out (Kass and Raftery 1995, Bayes factors).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from realsim.core.types import F64

FREEDOM = 4.0
"""Degrees of freedom of the groups' errors."""
EVIDENCE = 3.0
"""Log-odds from which a deviation is named, after the number of those that were tested has been paid."""
ROUNDS = 30
CLOSE = 1e-3


@dataclass(frozen=True)
class Fit:
    """What the data say about x."""

    mean: F64
    """(P,)"""
    covariance: F64
    """(P, P)"""
    prior: F64
    """(P,) standard deviations."""
    group_size: float
    """Standard deviation of an ordinary group's error."""
    noise: float
    weights: F64
    """(G,) 1 for ordinary groups, towards 0 for those that err much."""

    def bayes(self, which: list[int], wide: F64) -> float:
        """`bayes` of the parameters `which` (K,)."""
        return bayes(self.mean[which], self.covariance[np.ix_(which, which)], self.prior[which], wide)


def bayes(mean: F64, covariance: F64, prior: F64, wide: F64) -> float:
    """Log-likelihood gained by parameters (K,) having the prior `wide` (K,) in place of their own.

    Args:
        mean, covariance: (K,) and (K, K) of their posterior.
        prior, wide: (K,) standard deviations.
    """
    S0, S1, P = np.diag(prior**2), np.diag(wide**2), np.linalg.inv(covariance)
    h = P @ mean
    V1 = np.linalg.inv(P - np.linalg.inv(S0) + np.linalg.inv(S1))
    dets = [np.linalg.slogdet(M)[1] for M in (S0, S1, covariance, V1)]
    return float(0.5 * (dets[0] - dets[1] - dets[2] + dets[3] + h @ V1 @ h - h @ mean))


def fit(A: F64, y: F64, group: Any, prior: F64, start: tuple[float, float], robust: bool = True) -> Fit:
    """Posterior of x by EM over the groups' errors and the two sizes.

    Args:
        A: (N, P) design.
        y: (N,)
        group: (N,) int, 0 to G-1.
        prior: (P,) standard deviations.
        start: first guess of (a group's error, noise).
        robust: whether groups' errors have Student's t; else they are Gaussian.
    """
    groups = int(group.max()) + 1
    count = np.bincount(group, minlength=groups).astype(float)
    size, noise = start
    weights = np.ones(groups)
    member = np.zeros((groups, len(y)))
    member[group, np.arange(len(y))] = 1.0
    sums, totals, squares, products = member @ A, member @ y, A.T @ A, A.T @ y
    found = None
    for _ in range(ROUNDS):
        # With the groups' errors integrated out, a group's samples weigh 1/noise^2 less a share of their mean.
        share = (size**2 / weights) / (size**2 / weights * count + noise**2)
        information = (squares - (sums * share[:, None]).T @ sums) / noise**2 + np.diag(1 / prior**2)
        covariance = np.linalg.inv(information)
        mean = covariance @ ((products - sums.T @ (share * totals)) / noise**2)
        rest = y - A @ mean
        u = share * np.bincount(group, rest, minlength=groups)
        spread = ((sums @ covariance) * sums).sum(axis=1) * share**2 + share * noise**2
        square = u**2 + spread
        if robust:
            weights = (FREEDOM + 1) / (FREEDOM + square / size**2)
        rest = rest - u[group]
        leaves = float(rest @ rest + (share * noise**2 * count).sum())
        before = size, noise
        size = float(np.sqrt(np.mean(weights * square)))
        noise = float(np.sqrt(max(leaves, 1e-12) / len(y)))
        found = Fit(mean, covariance, prior, size, noise, weights)
        if abs(size / before[0] - 1) < CLOSE and abs(noise / before[1] - 1) < CLOSE:
            break
    assert found is not None
    return found
