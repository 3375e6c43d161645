"""What the report draws: arrays of the runs, of the check before and after, and of predictions from estimated states.

They are filled while the simulator is open; nothing that reads them simulates.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from realsim.core.errors import GapError
from realsim.core.types import F64
from realsim.gap.answer.patch import patched_xml
from realsim.gap.case.case import Case
from realsim.gap.case.model.channels import Channel
from realsim.gap.inference.causes.fitted import Fit
from realsim.gap.inference.evidence.inverse import TorqueResidual, torque_residual
from realsim.gap.inference.evidence.shooting import Shots, shoot
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.simulation.simulate import Simulator


@dataclass(frozen=True)
class Arrays:
    """Of C channels and R runs. A bin is `bin_seconds` wide; B bins a run."""

    case: Case
    channels: tuple[Channel, ...]
    bin_seconds: float
    settle_seconds: float
    """For which the first command was held before runs that begin at rest."""
    sensor: F64
    """(C,) noise of a sample, in the channel's unit."""
    detail: F64
    """(C,) size of slow errors that are everyday."""
    times: tuple[F64, ...]
    """(B,) a run, seconds."""
    floors: tuple[F64, ...]
    """(B, C) a run: mean square that a perfect diagnosis would leave."""
    residuals: tuple[F64, ...]
    """(B, C) a run: mean of measured less nominal in each bin."""
    shares: F64
    """(C, phases) of the squared gap."""
    runs: tuple[int, ...]
    """Of the check, indices into the case's."""
    before: tuple[F64, ...]
    """(T, C) a run of the check, nominal."""
    after: tuple[F64, ...]
    """(T, C) a run of the check, with the causes; empty where there are none, or where they cannot be simulated."""
    errors_before: tuple[F64, ...]
    """(B, C) a run of the check: mean of measured less nominal in each bin."""
    shots: tuple[Shots, ...]
    """Predictions from estimated states in the runs of the check: nominal, and with the causes where there are any."""
    torque: TorqueResidual | None
    nominal_xml: str
    """The nominal model as MuJoCo writes it."""
    patched_xml: str
    """The model with the causes, as far as MJCF can hold them."""
    reason: str = ""
    """Why something is not drawn, or nothing."""


def collect(
    simulator: Simulator,
    comparison: Comparison,
    residuals: Sequence[F64],
    shares: F64,
    runs: Sequence[int],
    fit: Fit,
) -> Arrays:
    """Simulate the runs of the check with and without the causes, and keep what is drawn."""
    case = simulator.case
    before = tuple(simulator.simulate(runs=runs))
    shots: tuple[Shots, ...] = (shoot(simulator, runs=runs),)
    after: tuple[F64, ...] = ()
    reason = "" if fit.causes else "No cause was found, so there is nothing to add."
    if fit.causes:
        try:
            onsets = fit.conditions.onsets
            after = tuple(simulator.simulate(fit.settings(), runs, onsets=onsets))
            shots = (*shots, shoot(simulator, fit.settings(), runs, onsets))
        except GapError as error:
            after, reason = (), f"The patched simulator does not run: {error.message}"
    spec = case.spec.copy()
    spec.compile()
    return Arrays(
        case=case,
        channels=comparison.channels,
        bin_seconds=comparison.config.bin_seconds,
        settle_seconds=comparison.config.settle_seconds,
        sensor=comparison.noise.sensor,
        detail=comparison.noise.detail,
        times=tuple(comparison.times),
        floors=tuple(comparison.floor(i) for i in range(len(case.runs))),
        residuals=tuple(residuals),
        shares=shares,
        runs=tuple(runs),
        before=before,
        after=after,
        errors_before=tuple(comparison.residual(r, y) for r, y in zip(runs, before, strict=True)),
        shots=shots,
        torque=torque_residual(simulator),
        nominal_xml=str(spec.to_xml()),
        patched_xml=patched_xml(simulator, fit.settings()),
        reason=reason,
    )
