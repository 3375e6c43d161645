"""Choose the experiment that tells the rivals apart best, among those that stay within the limits."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap.experiments.excitations import EXCITATIONS
from realsim.gap.experiments.plan import Experiment
from realsim.gap.experiments.rivals import Rival
from realsim.gap.experiments.separation import Bench, Predicted, expected_posterior, separations

SIZES = (1.0, 0.7, 0.45, 0.25)
"""Shares of the commands' range, tried from large to small until one stays within the limits."""
FINALISTS = 3
"""Excitations whose everyday deviations are simulated: they cost more than all the rest."""
ENOUGH = 16.0
"""Least separation of any two rivals from which on an experiment counts as decisive: a log Bayes factor of 8 is to be
expected. Not tuned."""

WORTH_IT = 1.2
"""Times the even odds that the true rival's expected posterior must reach for an experiment to be requested."""


@dataclass(frozen=True)
class Looked:
    """One excitation that was looked at."""

    name: str
    title: str
    size: float
    refused: str = ""
    """The limit that even the smallest size leaves, or why the robot cannot do it."""
    predicted: Predicted | None = None
    separation: F64 | None = None
    """(n, n), see `realsim.gap.experiments.separation`."""
    with_deviations: bool = False
    """Whether everyday deviations are in it; those looked at first leave them out."""

    @property
    def worst(self) -> float:
        """Least separation of any pair of rivals."""
        if self.separation is None:
            return 0.0
        n = len(self.separation)
        return float(min(self.separation[i, j] for i in range(n) for j in range(n) if i != j))

    @property
    def posterior(self) -> float:
        """Probability that the true rival may expect, the mean over which it is."""
        return 0.0 if self.separation is None else float(expected_posterior(self.separation).mean())

    @property
    def helps(self) -> bool:
        """Whether a recording may be expected to favour the true rival."""
        return self.separation is not None and self.posterior > WORTH_IT / len(self.separation)

    @property
    def decides(self) -> bool:
        return self.worst >= ENOUGH


def look(
    bench: Bench,
    rivals: Sequence[Rival],
    names: Sequence[str] = (),
    tick: Callable[[str, float], None] = lambda what, share: None,
    finalists: int = FINALISTS,
) -> list[Looked]:
    """All excitations (or those named), the best first. Those that leave the limits at any size stand last.

    Args:
        finalists: the everyday deviations of this many are simulated.

    Raises:
        GapError: with fewer than two rivals.
        UnknownNameError: for a name that is no excitation.
    """
    if len(rivals) < 2:
        raise GapError(
            "there is nothing to tell apart",
            expected="a diagnosis with at least two sets of causes (verdict ambiguous)",
            found=f"{len(rivals)} set" + "s" * (len(rivals) != 1),
        )
    chosen = list(names or EXCITATIONS)
    found = []
    for k, name in enumerate(chosen):
        tick(name.replace("_", " "), k / (len(chosen) + finalists))
        found.append(_largest(bench, rivals, name))
    found.sort(key=_rank)
    for k, one in enumerate(found[:finalists]):
        if one.predicted is not None:
            tick("everyday deviations", (len(chosen) + k) / (len(chosen) + finalists))
            deviations = bench.deviations(one.predicted)
            separation = separations(one.predicted, rivals, deviations)
            found[k] = Looked(one.name, one.title, one.size, "", one.predicted, separation, True)
    return sorted(found[:finalists], key=_rank) + found[finalists:]


def _rank(one: Looked) -> tuple[bool, float, float]:
    return bool(one.refused), -round(one.posterior, 2), -one.worst


def _largest(bench: Bench, rivals: Sequence[Rival], name: str) -> Looked:
    """The excitation at the largest size that stays within the limits under every rival."""
    make: Callable[..., Experiment | None] = EXCITATIONS[name]
    reason, title = "this robot or its log cannot do it", name.replace("_", " ")
    for size in SIZES:
        experiment = make(bench.rig, size)
        if experiment is None:
            break
        title = experiment.title
        predicted = bench.predicted(experiment, rivals)
        if isinstance(predicted, str):
            reason = predicted
            continue
        return Looked(name, title, size, "", predicted, separations(predicted, rivals))
    return Looked(name, title, 0.0, reason)
