"""Two gloo ranks are one rank with twice the worlds."""

import math
import os
import socket
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from tests.trainer.test_ppo import CONFIG, CPU, runner
from tests.trainer.toy import LAYOUT, PointMass
from trainer.errors import TrainerError
from trainer.ppo import policy as policies
from trainer.ppo.distributed import pick_device, ranks
from trainer.ppo.loop import LoopConfig, train
from trainer.ppo.runner import Runner, _read

WHOLE = replace(CONFIG, minibatches=1, epochs=2)  # shuffled minibatches would be other ones on each rank


def samples(worlds: slice) -> dict[str, torch.Tensor]:
    """A made-up rollout of eight worlds, the part of these worlds."""
    rng = torch.Generator().manual_seed(7)

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(WHOLE.steps, 8, *shape, generator=rng)[:, worlds]

    return {
        "actor": draw(2), "critic": draw(3), "action": draw(2), "mean": 0.1 * draw(2),
        "log_prob": -2.5 + 0.1 * draw(), "value": draw(), "reward": draw(),
    }  # fmt: skip


def one_update(r: Runner, worlds: slice) -> None:
    for name, value in samples(worlds).items():
        getattr(r.rollout, name).copy_(value)
    rng = torch.Generator().manual_seed(8)
    r.rollout.frames.frames.copy_(torch.rand(20, 8, 6, 8, generator=rng)[:, worlds])
    r.rollout.frames.restart()
    r.rollout.done[5] = True
    last = PointMass(8).reset().map(lambda x: x[worlds])
    r.ppo.finish(r.rollout, last)
    r.ppo.update(r.rollout, r.rng)


def weights(r: Runner) -> dict[str, torch.Tensor]:
    return {**r.policy.actor.state_dict(), **{f"critic.{k}": v for k, v in r.policy.critic.state_dict().items()}}


def rank_main(index: int, port: int, folder: str) -> None:
    torch.set_num_threads(1)
    os.environ |= {"RANK": str(index), "WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port)}
    with ranks("cpu") as rank:
        # Another seed on each rank: the first rank's weights must be broadcast.
        r = Runner(PointMass(4), policies.new(LAYOUT, WHOLE.networks, "toy", index), WHOLE, rank=rank)
        one_update(r, slice(4 * index, 4 * index + 4))
        torch.save({**weights(r), "rate": r.ppo.learning_rate}, f"{folder}/rank{index}.pt")
        nan, mine = torch.tensor(float("nan")), torch.tensor(1.0 + index)
        losses = {"sound": mine, "broken": nan if index else mine}
        read = _read(losses, {"env/all": mine, "env/first": nan if index else mine, "env/none": nan, "return": nan})
        torch.save(read, f"{folder}/read{index}.pt")
        # A checkpoint of one rank goes on with two, and stops for both when the first says so.
        again = Runner(PointMass(4, seed=index), policies.new(LAYOUT, CONFIG.networks, "toy", 0), CONFIG, rank=rank)
        loop = LoopConfig(iterations=9, evaluate_every=1, stop_at_target=True, tensorboard=False)
        out = Path(folder) / "out"
        history = train(again, loop, out, evaluate=lambda policy: 1.0, resume=Path(folder) / "one" / "policy.pt")
        assert again.iteration == 2
        assert any("2 ranks instead of 1" in note for note in history.notes)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ranks")
    train(runner(worlds=4), LoopConfig(iterations=1, tensorboard=False), folder / "one")
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
    # Imported once for both; the latter by an optimiser's first step.
    torch.multiprocessing.get_context("forkserver").set_forkserver_preload([__name__, "torch._dynamo"])
    start = torch.multiprocessing.start_processes
    start(rank_main, (port, str(folder)), nprocs=2, start_method="forkserver")
    return folder


def test_two_ranks_update_as_one_with_twice_the_worlds(folder: Path) -> None:
    one = Runner(PointMass(8), policies.new(LAYOUT, WHOLE.networks, "toy", 0), WHOLE, rank=CPU)
    one_update(one, slice(0, 8))
    first, second = (torch.load(folder / f"rank{i}.pt", weights_only=True) for i in range(2))
    for name, value in weights(one).items():
        assert torch.equal(first[name], second[name]), name
        assert torch.allclose(first[name], value, atol=2e-5), name
    assert first["rate"] == second["rate"] == one.ppo.learning_rate


def test_what_one_rank_has_not_seen_is_the_others_figure(folder: Path) -> None:
    """No episode ended on the second rank; a loss that is not a number there is not passed over."""
    for index in range(2):
        read = torch.load(folder / f"read{index}.pt", weights_only=True)
        assert (read["sound"], read["env/all"], read["env/first"]) == (1.5, 1.5, 1.0)
        assert math.isnan(read["broken"])
        assert math.isnan(read["return"])
        assert "env/none" not in read


def test_two_ranks_write_one_checkpoint_with_both_curricula(folder: Path) -> None:
    saved = torch.load(folder / "out" / "policy.pt", weights_only=True)["training"]
    assert len(saved["ranks"]) == 2
    assert saved["iteration"] == 2
    assert saved["samples"] == 16 * 4 + 16 * 8
    one, other = saved["ranks"]  # from one checkpoint, and yet they draw neither the same noise nor the same worlds
    assert not torch.equal(one["rng"], other["rng"])
    assert not torch.equal(one["env"]["rng"], other["env"]["rng"])
    fewer = runner(worlds=4)
    notes = fewer.load_state_dict(saved)
    assert "resumed on 1 ranks instead of 2" in notes[0]
    fewer.iterate()


def test_the_device_follows_the_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert pick_device("auto", engine="mujoco").type == "cpu"
    assert pick_device("auto", engine="warp").type == pick_device("auto").type == "cuda"
    with ranks("auto", "mujoco") as rank:
        assert rank.device.type == "cpu"
    with pytest.raises(TrainerError, match="mujoco runs on the CPU"):
        pick_device("cuda", engine="mujoco")


def test_a_run_goes_on_from_another_kind_of_device(folder: Path) -> None:
    saved = torch.load(folder / "one" / "policy.pt", weights_only=True)["training"]
    saved["ranks"][0]["rng"] = torch.zeros(16, dtype=torch.uint8)  # what a GPU's generator saves
    again = runner(worlds=4)
    assert "another kind of device" in again.load_state_dict(saved)[0]
    again.iterate()


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a GPU")
def test_no_gpu_is_said() -> None:
    with pytest.raises(TrainerError, match="no CUDA device") as caught:
        pick_device("cuda")
    assert "--device cpu" in caught.value.hint
    assert pick_device("auto").type == "cpu"
