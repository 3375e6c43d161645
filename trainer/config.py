"""What can be set about trials and deployment of a policy, and what trials find: apart from code that needs torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from trainer.errors import TrainerError, check_fields
from trainer.fields import brief, filled

FORMAT = "realsim.evaluation/1"
"""Of the JSON of trials."""


@dataclass(frozen=True)
class EvaluationConfig:
    """Number of trials, and what varies between them."""

    trials: int = 1000
    """On each terrain."""
    worlds: int = 250
    """Trials that run at once; part of what a seed means."""
    seed: int = 0
    """Of everything random in the trials."""
    randomise: bool = True
    """Whether friction, masses, gains, delays and sensor noise vary as in training; the starting pose always does."""
    pushes: bool = False
    """Whether the robot is pushed."""
    finish: Literal["reach", "stop"] = "reach"
    """When a trial succeeds. reach: at a constant speed, as `realsim deploy` and the paper, when base and feet are
    over the goal platform. stop: at a speed that falls with the distance to the goal, when the robot has stayed there
    for a second, as in training."""
    bin_m: float = 0.25
    """Metres a bin of the failures along the course."""

    def __post_init__(self) -> None:
        check_fields(self, above={"bin_m": 0}, least={"trials": 1, "worlds": 1})


@dataclass(frozen=True)
class DeployConfig:
    """How the loop runs."""

    seconds: float = 10.0
    """Longest run."""
    speed: float = 0.8
    """Forward velocity command, m/s."""
    ramp: float = 0.0
    """Seconds over which the command rises from zero."""
    max_tilt: float = 1.0
    """Radians from upright at which the loop gives up."""
    max_step: float = 3.0
    """Radians that a joint target may be away from the joint: beyond, it is clipped."""
    max_late: int = 5
    """Steps in a row that may miss their time before the loop gives up."""
    realtime: bool = True
    """Keep to the clock; without, a simulated robot runs as fast as it can."""

    def __post_init__(self) -> None:
        check_fields(self, above={"seconds": 0, "max_tilt": 0, "max_step": 0}, least={"ramp": 0, "max_late": 1})


@dataclass(frozen=True)
class Result:
    """One terrain."""

    terrain: str
    geometry: str
    """`trained` for the contact geometry that is trained on, `finer` for one that is not."""
    trials: int
    successes: int
    interval: tuple[float, float]
    """Wilson's 95 percent interval of the success rate."""
    reasons: dict[str, int]
    """Cause -> failed trials; `timeout` is one."""
    where: tuple[dict[str, float], ...]
    """Bins along the course with failures: `from_m`, `to_m` (from the start platform's centre) and count by cause."""
    failures: tuple[dict[str, Any], ...]
    """Each failed trial: number, cause, position (m, terrain frame), seconds."""
    seconds: float | None
    """Mean duration of successful trials; None without any."""
    covered: float
    """Mean share of the way."""
    overflowed: int
    """Contacts dropped because a buffer was full; more than 0 makes the figures doubtful."""

    def __post_init__(self) -> None:
        if not 0 <= self.successes <= self.trials or self.trials < 1:
            raise TrainerError(
                "trials and successes contradict", found=f"{self.successes} successes in {self.trials} trials"
            )

    @property
    def rate(self) -> float:
        return self.successes / self.trials

    @property
    def bins(self) -> list[tuple[float, float, dict[str, int]]]:
        """`where` as from, to, and failures by cause."""
        return [
            (w["from_m"], w["to_m"], {k: int(v) for k, v in w.items() if k not in ("from_m", "to_m")})
            for w in self.where
        ]


@dataclass(frozen=True)
class Evaluation:
    """All terrains."""

    results: tuple[Result, ...]
    config: EvaluationConfig = EvaluationConfig()
    warnings: tuple[str, ...] = ()
    robot: str = ""
    engine: str = ""

    @property
    def success(self) -> float:
        """Success rate over the terrains trained on, each trial counting once."""
        own = [r for r in self.results if r.geometry == "trained"]
        return sum(r.successes for r in own) / sum(r.trials for r in own)

    def as_dict(self) -> dict[str, Any]:
        return {
            "format": FORMAT,
            "success": self.success,
            "robot": self.robot,
            "engine": self.engine,
            "config": vars(self.config),
            "warnings": list(self.warnings),
            "terrains": [vars(r) | {"rate": r.rate} for r in self.results],
        }

    @classmethod
    def of(cls, data: Any, file: Path) -> Evaluation:
        """The inverse of `as_dict`.

        Raises:
            TrainerError: it is none, or damaged.
        """
        if not isinstance(data, dict) or data.get("format") != FORMAT or not isinstance(data.get("terrains"), list):
            found = brief(data.get("format") if isinstance(data, dict) else data)
            raise TrainerError("not an evaluation of realsim", file=file, expected=f"format {FORMAT}", found=found)
        results = [{k: v for k, v in t.items() if k != "rate"} if isinstance(t, dict) else t for t in data["terrains"]]
        other = {k: data[k] for k in ("config", "warnings", "robot", "engine") if k in data}
        return filled(cls, {"results": results, **other}, "entry of an evaluation", file)
