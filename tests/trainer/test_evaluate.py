"""Trials: counted once each, repeatable, with reasons and places; replay draws what was recorded."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from realsim.core.errors import UnknownNameError
from realsim.core.files import to_json
from tests.trainer.fakes import BoxCaster, FakePhysics, course, quadruped, walk
from tests.trainer.task_env import QUIET, outcome
from trainer.errors import TrainerError
from trainer.evaluate import EvaluationConfig, Setting, evaluate, run, summarise, trial_config, wilson
from trainer.physics import PhysicsConfig
from trainer.replay import record, write
from trainer.tasks.parkour import ParkourConfig, ParkourEnv, make
from trainer.tasks.parkour.config import DepthConfig, ResetConfig, TerminationConfig
from trainer.tasks.parkour.terminations import OUTCOMES
from trainer.terrain import flat, generate

QUICK = replace(QUIET, termination=TerminationConfig(seconds=2.0))


def zero(observation):
    return torch.zeros(len(observation.actor), 12)


def test_wilson_against_published_values():
    # Newcombe 1998, table I, method 3: 81/263, 15/148, 0/20, 1/29.
    for x, n, low, high in [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ]:
        assert wilson(x, n) == pytest.approx((low, high), abs=1e-4)


def test_every_trial_counts_once_even_if_some_end_early():
    """World 0 falls after 5 steps again and again, the others arrive: 1 of 4 trials fails, not most of them."""
    falls = {"age": 0}

    def motion(physics):
        if physics.state.base_pos[1, 0] < 3.0:
            walk(2.0)(physics)
        falls["age"] += 1
        physics.state.ground_contact[0] = falls["age"] % 5 == 0

    physics = FakePhysics(quadruped(), [course()], 4, motion)
    env = ParkourEnv(physics, BoxCaster([course()]), [np.zeros((0, 2, 3))], QUIET)
    trials = run(zero, env, 4)
    names = [OUTCOMES[k] for k in trials.outcome.tolist()]
    assert names == ["ground", "success", "success", "success"]
    again = [OUTCOMES[k] for k in run(zero, env, 6).outcome.tolist()]  # two rounds, of which six trials count
    assert len(again) == 6
    assert again[0] == again[4] == "ground"
    result = summarise(course(), "trained", trials, env, EvaluationConfig(trials=4))
    assert result.rate == 0.75
    assert result.reasons == {"ground": 1}
    assert result.failures[0]["trial"] == 0
    # Five steps of 2 m/s x 20 ms: the fall is in the bin from 0 to 0.25 m.
    assert result.where == ({"from_m": 0.0, "to_m": 0.25, "ground": 1},)
    # The hind feet, 15 cm behind the base, pass the platform's border at 2.55 m; then a second on it.
    assert result.seconds == pytest.approx((2.55 + 0.15) / 2.0 + 1.0, abs=0.03)


def test_a_trial_is_fresh_true_to_size_and_never_pushed():
    task = trial_config(ParkourConfig(reset=ResetConfig(spread_ages=True), amp=True), EvaluationConfig())
    assert not task.reset.spread_ages
    assert task.randomisation.push == 0
    assert task.randomisation.terrain_variants == 1
    assert task.randomisation.use
    quiet = trial_config(ParkourConfig(), EvaluationConfig(randomise=False))
    assert not quiet.observation.noise
    assert quiet.depth.noise == quiet.depth.dropout == 0


@pytest.fixture(scope="module")
def small():
    """The quadruped without depth images, 2 seconds a trial."""
    return Setting(robot="quadruped", task=ParkourConfig(depth=DepthConfig(use=False), termination=QUICK.termination))


def test_the_same_seed_gives_the_same_evaluation(small):
    config = EvaluationConfig(trials=5, worlds=4, seed=3)
    noisy = lambda o: 2 * torch.sin(40 * o.actor[:, -12:] + o.actor[:, :1])  # noqa: E731
    a = evaluate(noisy, course(), config, small)
    b = evaluate(noisy, course(), config, small)
    c = evaluate(noisy, course(), replace(config, seed=4), small)
    assert a.as_dict() == b.as_dict()
    assert a.as_dict() != c.as_dict()
    assert a.results[0].trials == 5
    data = json.loads(to_json(a.as_dict()))
    assert data["format"] == "realsim.evaluation/1"
    assert data["terrains"][0]["geometry"] == "trained"
    assert sum(data["terrains"][0]["reasons"].values()) == 5 - data["terrains"][0]["successes"]


def test_a_finer_geometry_is_reported_beside_and_does_not_count(small):
    config = EvaluationConfig(trials=2, worlds=2)
    found = evaluate(zero, [flat()], config, small, finer=[generate("boxes", 0.0, 1)])
    assert [r.geometry for r in found.results] == ["trained", "finer"]
    assert found.success == found.results[0].rate == 0
    assert found.results[0].reasons == {"timeout": 2}


def test_the_real_engine_stands_on_flat_and_generated_ground(small):
    """The quadruped holds its pose: no failure, a calm robot, a reward near that of being alive and waiting."""
    for terrain in (flat(), generate("stakes", 0.2, 5)):
        env = make(trial_config(small.task, EvaluationConfig()), [terrain], robot="quadruped", worlds=4)
        env.reset()
        for _ in range(60):
            step = env.step(torch.zeros(4, 12))
            assert env.ends is None, outcome(env)
        assert env.physics.state.base_lin_vel.norm(dim=-1).max() < 0.2
        assert (step.reward > 0.02).all()
        assert step.observation.actor.isfinite().all()


def test_no_gpu_is_said(small):
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    with pytest.raises(TrainerError, match="no such CUDA device"):
        make(small.task, [flat()], robot="quadruped", physics=PhysicsConfig(device="cuda:0"))


@pytest.mark.parametrize("settings", [{"trials": 0}, {"worlds": 0}, {"bin_m": 0.0}])
def test_senseless_settings_are_refused(settings):
    with pytest.raises(TrainerError):
        EvaluationConfig(**settings)


# ---------------------------------------------------------------- replay


@pytest.fixture(scope="module")
def recording(small):
    short = replace(small.task, termination=TerminationConfig(seconds=0.6))
    return record(zero, make(trial_config(short, EvaluationConfig()), [course()], robot="quadruped", worlds=2), world=1)


def test_a_recording_is_a_whole_episode(recording):
    assert recording.outcome == "timeout"
    assert recording.qpos.shape == (30, 7 + 12)


def test_an_unknown_format_is_refused(recording, tmp_path):
    with pytest.raises(UnknownNameError, match=r"\.glb"):
        write(recording, quadruped(), course(), tmp_path / "trial.avi")


def test_a_glb_moves_its_bodies_as_recorded(recording, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    path = write(recording, quadruped(), generate("boxes", 0.2, 1), tmp_path / "trial.glb")
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    document, binary = json.loads(data[20 : 20 + length]), data[28 + length :]
    assert int.from_bytes(data[8:12], "little") == len(data)
    assert document["buffers"][0]["byteLength"] == len(binary)

    def read(accessor, width):
        entry = document["accessors"][accessor]
        view = document["bufferViews"][entry["bufferView"]]
        raw = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        return np.frombuffer(raw, "<f4").reshape(entry["count"], width)

    animation = document["animations"][0]
    names = [node["name"] for node in document["nodes"]]
    base = names.index(quadruped().base)
    tracks = {
        c["target"]["path"]: animation["samplers"][c["sampler"]]
        for c in animation["channels"]
        if c["target"]["node"] == base
    }
    assert np.allclose(read(tracks["translation"]["output"], 3), recording.qpos[:, :3], atol=1e-6)
    assert np.allclose(
        np.abs(read(tracks["rotation"]["output"], 4)), np.abs(np.roll(recording.qpos[:, 3:7], -1, 1)), atol=1e-5
    )
    assert np.allclose(read(tracks["rotation"]["input"], 1)[:, 0], 0.02 * np.arange(30), atol=1e-6)
    scene = trimesh.load(path)
    assert {"ground", "terrain"} < set(scene.geometry)
    assert (
        path.read_bytes() == write(recording, quadruped(), generate("boxes", 0.2, 1), tmp_path / "b.glb").read_bytes()
    )
