"""Never worse than the base: the test, what is delivered, and a training that goes back to its best policy."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from tests.trainer.test_ppo import BRIEF, runner
from trainer.evaluate import Evaluation, EvaluationConfig, Result
from trainer.ppo import checkpoint, policy
from trainer.ppo.config import LoopConfig, StrategyConfig
from trainer.ppo.loop import train
from trainer.verdict import judge


def trials(won: int, of: int = 100, cause: str = "ground") -> Evaluation:
    where = ({"from_m": 1.0, "to_m": 1.25, cause: of - won},) if won < of else ()
    result = Result("beams", "trained", of, won, (0.0, 1.0), {cause: of - won}, where, (), None, 0.5, 0)
    return Evaluation((result,), EvaluationConfig(trials=of))


def test_only_what_beats_the_base_beyond_chance_is_delivered() -> None:
    assert judge(trials(60), trials(90)).better
    for before, after in ((60, 66), (60, 60), (60, 0), (100, 100)):
        assert not judge(trials(before), trials(after)).better
    worse = judge(trials(60), trials(5, cause="timeout"))
    assert worse.as_dict()["delivered"] == "base"
    assert "1.00 to 1.25 m" in worse.failures[0]
    assert any("waits" in line for line in worse.advice)


@pytest.mark.parametrize(
    ("won", "seconds", "says"),
    [(40, 0.3, "within 0.3 s"), (0, 5.0, "no trial reached the goal, 30%"), (40, 5.0, "time")],
)
def test_what_to_try_follows_how_it_fails(won: int, seconds: float, says: str) -> None:
    after = trials(won)
    failures = tuple({"seconds": seconds} for _ in range(100 - won))
    after = replace(after, results=(replace(after.results[0], failures=failures, covered=0.3),))
    assert says in judge(trials(won), after).advice[0]


def tuned(**settings: float):
    """A runner of a policy that is fine-tuned, whose environment says what share of the time robots wait."""
    r = runner(BRIEF, worlds=4)
    r.policy.tuned = (("full", StrategyConfig()),)
    iterate = r.iterate
    r.iterate = lambda: {**iterate(), "env/episode/waiting": settings.get("waiting", 0.1)}
    return r


def weights(file: Path, latest: bool = False) -> list[torch.Tensor]:
    return list(checkpoint.load(file, latest=latest)[0].actor.state_dict().values())


def test_the_policy_of_the_best_trials_is_written_and_training_goes_on_from_the_latest(tmp_path: Path) -> None:
    rates, seen = iter([0.2, 0.6, 0.5, 0.6]), []

    def rate(p: policy.Policy) -> float:
        seen.append([x.clone() for x in p.actor.state_dict().values()])
        return next(rates)

    train(
        tuned(),
        LoopConfig(iterations=3, evaluate_every=1, evaluate_share=1.0, tensorboard=False),
        tmp_path,
        evaluate=rate,
    )
    file = tmp_path / "policy.pt"
    assert all(map(torch.equal, weights(file), seen[1]))
    assert all(map(torch.equal, weights(file, latest=True), seen[3]))


@pytest.mark.parametrize(("waiting", "rates"), [(0.9, [0.5, 0.5]), (0.1, [0.5, 0.1])])
def test_standing_still_or_a_fall_of_success_ends_at_the_best_policy(
    waiting: float, rates: list[float], tmp_path: Path
) -> None:
    r, answers, eased = tuned(waiting=waiting), iter(rates), []
    first = [x.clone() for x in r.policy.actor.state_dict().values()]
    r.env.ease = lambda: eased.append(r.iteration)
    went_back = []
    go_back = r.go_back
    r.go_back = lambda best: (
        go_back(best),
        went_back.append([x.clone() for x in r.policy.actor.state_dict().values()]),
    )
    config = LoopConfig(iterations=29, evaluate_every=10, evaluate_share=1.0, tensorboard=False)
    history = train(r, config, tmp_path, evaluate=lambda p: next(answers, 0.4))
    assert eased
    assert eased[0] <= 30
    assert all(map(torch.equal, went_back[0], first))
    assert "back" in history.notes[0]
