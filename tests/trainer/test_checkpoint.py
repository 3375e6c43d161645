"""Policies on disk: whole, readable without running code, and refused with a reason."""

import io
import json
import pickle
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from realsim.core.errors import RealsimError
from tests.trainer.test_ppo import SMALL
from tests.trainer.toy import LAYOUT
from trainer.ppo import checkpoint, export
from trainer.ppo import policy as policies
from trainer.ppo.config import StrategyConfig
from trainer.ppo.policy import Policy
from trainer.tasks import Observation


def make(*strategies: str) -> Policy:
    policy = policies.new(LAYOUT, SMALL, "toy", 3)
    for name in strategies:
        policy = policies.fine_tune(policy, name, StrategyConfig())
        for parameter in policy.actor.parameters():
            if parameter.requires_grad:
                parameter.data += 0.1
    return policy


def observation(rows: int = 5) -> Observation:
    rng = torch.Generator().manual_seed(0)
    return Observation(
        torch.randn(rows, 2, generator=rng),
        torch.randn(rows, 3, generator=rng),
        torch.rand(rows, 3, 6, 8, generator=rng),
    )


@pytest.mark.parametrize("strategies", [(), ("full",), ("last_layer", "adapter"), ("adapter", "residual")])
def test_round_trip(tmp_path: Path, strategies: tuple[str, ...]) -> None:
    policy = make(*strategies)
    checkpoint.save(tmp_path / "a.pt", policy)
    back, training = checkpoint.load(tmp_path / "a.pt")
    assert training is None
    assert torch.equal(back.act(observation()), policy.act(observation()))
    assert (back.layout, back.networks, back.robot, back.tuned) == (LAYOUT, SMALL, "toy", policy.tuned)
    trained = [p.requires_grad for p in policy.actor.parameters()]
    assert [p.requires_grad for p in back.actor.parameters()] == trained


@pytest.mark.parametrize("kept", [0.0, 0.02, 0.5, 0.99])
def test_a_checkpoint_that_was_cut_off_is_named(tmp_path: Path, kept: float) -> None:
    path = tmp_path / "cut.pt"
    checkpoint.save(path, make())
    data = path.read_bytes()
    path.write_bytes(data[: int(kept * len(data))])
    with pytest.raises(RealsimError, match=r"cut off|not a policy checkpoint") as caught:
        checkpoint.load(path)
    assert caught.value.file == str(path)


def test_one_wrong_bit_among_the_weights_is_noticed(tmp_path: Path) -> None:
    """torch itself loads them: it does not look at the checksums of its archive."""
    path = tmp_path / "flipped.pt"
    checkpoint.save(path, make())
    data = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as archive:
        weights = max(archive.infolist(), key=lambda item: item.file_size)
    data[weights.header_offset + 200 + weights.file_size // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(RealsimError, match="damaged"):
        checkpoint.load(path)


def test_other_versions_other_files_and_code_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.pt"
    checkpoint.save(path, make())
    data = torch.load(path, weights_only=True)
    torch.save({**data, "version": 99}, path)
    with pytest.raises(RealsimError, match="another version") as caught:
        checkpoint.load(path)
    assert caught.value.found == "version 99"
    torch.save({"weights": torch.zeros(3)}, path)
    with pytest.raises(RealsimError, match="not a policy checkpoint of realsim"):
        checkpoint.load(path)
    torch.save({**data, "networks": {**data["networks"], "latent": 17}}, path)
    with pytest.raises(RealsimError, match="do not fit together"):
        checkpoint.load(path)
    buffer = io.BytesIO()
    torch.save({"format": Path("x")}, buffer, pickle_module=pickle)
    path.write_bytes(buffer.getvalue())
    with pytest.raises(RealsimError, match="not a policy checkpoint"):
        checkpoint.load(path)
    with pytest.raises(RealsimError, match="cannot be read"):
        checkpoint.load(tmp_path / "absent.pt")
    mesh = tmp_path / "stairs.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(RealsimError, match="not a policy") as caught:
        checkpoint.load(mesh)
    assert caught.value.found == "a mesh"
    assert "realsim contact" in str(caught.value.hint)


def test_weights_that_are_not_numbers_are_refused(tmp_path: Path) -> None:
    policy = make()
    path = tmp_path / "a.pt"
    policy.critic.trunk[0].layer.weight.data[1, 0] = float("nan")
    checkpoint.save(path, policy)
    with pytest.raises(RealsimError, match="not all numbers") as caught:
        checkpoint.load(path)
    assert caught.value.found == "critic.trunk.0.layer.weight: 1 of 608 are not"


def test_a_failed_write_leaves_the_old_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.pt"
    checkpoint.save(path, make())
    before = path.read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(RealsimError, match="cannot write"):
        checkpoint.save(path, make("full"))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def facts(policy: Policy) -> export.Deployment:
    return export.Deployment(
        policy.layout, policy.robot, 0.02, (0.0, 0.1), (0.5, 0.5), (20.0, 20.0), (1.0, 1.0), 0.2, 2.0
    )


@pytest.mark.parametrize("strategies", [(), ("adapter", "residual")])
def test_onnx_computes_the_same_and_carries_its_layout(tmp_path: Path, strategies: tuple[str, ...]) -> None:
    policy = make(*strategies)
    path = tmp_path / "a.onnx"
    assert export.export(path, policy, facts(policy)) <= 1e-5
    runtime, found = export.load(str(path))
    assert found == facts(policy)
    o = observation(7)  # another batch than it was exported with
    (action,) = runtime.run(None, {"vector": o.actor.numpy(), "depth": o.depth.numpy()})
    assert np.allclose(action, policy.act(o).numpy(), atol=1e-5)


class Other(torch.nn.Module):
    """What a strategy of somebody else's may do."""

    def __init__(self) -> None:
        super().__init__()
        self.base, self.wide = make().actor, torch.nn.Conv2d(3, 4, 3, stride=(1, 2), padding=2, dilation=2)
        self.out = torch.nn.Linear(4 * 6 * 4, 2)

    def forward(self, vector: torch.Tensor, depth: torch.Tensor) -> torch.Tensor:
        x = torch.sigmoid(self.wide(depth).relu()).exp().flatten(1)
        return self.base(vector, depth) / 2.0 + torch.tanh(self.out(x))


def test_networks_of_other_strategies_are_written_or_the_operation_is_named(tmp_path: Path) -> None:
    policy = make()
    policy.actor = Other()
    assert export.export(tmp_path / "a.onnx", policy, facts(policy)) <= 1e-5
    policy.actor.forward = lambda vector, depth: torch.linalg.svdvals(policy.actor.base(vector, depth))
    with pytest.raises(RealsimError, match="cannot be written as ONNX") as refused:
        export.export(tmp_path / "b.onnx", policy, facts(policy))
    assert "svd" in refused.value.found
    assert not (tmp_path / "b.onnx").exists()


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A policy file whose actions are limited to 20."""
    policy, path = make(), tmp_path_factory.mktemp("exported") / "a.onnx"
    export.export(path, policy, replace(facts(policy), action_limit=20.0))
    return path.read_bytes()


def test_onnx_of_before_the_action_limit_has_none(exported: bytes, tmp_path: Path) -> None:
    import onnx

    path = tmp_path / "a.onnx"
    path.write_bytes(exported)
    assert export.load(path)[1].action_limit == 20.0
    model = onnx.load_model(path)
    meta = json.loads(model.metadata_props[-1].value)
    del meta["action_limit"]
    model.metadata_props[-1].value = json.dumps(meta)
    onnx.save_model(model, path)
    assert export.load(path)[1] == facts(make())


def test_onnx_without_metadata_or_cut_off_is_refused(exported: bytes, tmp_path: Path) -> None:
    import onnx

    path = tmp_path / "a.onnx"
    path.write_bytes(exported[: len(exported) // 2])
    with pytest.raises(RealsimError, match=r"cut off|not an ONNX file"):
        export.load(path)
    model = onnx.load_model_from_string(exported)
    meta = json.loads(model.metadata_props[-1].value)
    model.metadata_props[-1].value = json.dumps({**meta, "version": 9})
    path.write_bytes(model.SerializeToString())
    with pytest.raises(RealsimError, match="another version"):
        export.load(path)
    del model.metadata_props[:]
    path.write_bytes(model.SerializeToString())
    with pytest.raises(RealsimError, match="does not describe its observations"):
        export.load(path)


def test_a_network_that_fails_when_it_runs_is_refused_when_it_is_read(exported: bytes, tmp_path: Path) -> None:
    import onnx

    path = tmp_path / "a.onnx"
    model = onnx.load_model_from_string(exported)
    bias = max((t for t in model.graph.initializer if len(t.dims) == 1), key=lambda t: t.dims[0])
    bias.CopyFrom(onnx.numpy_helper.from_array(onnx.numpy_helper.to_array(bias)[:-1], bias.name))
    path.write_bytes(model.SerializeToString())
    with pytest.raises(RealsimError) as refused:
        export.load(path)
    assert refused.value.file == str(path)


def test_a_layout_that_differs_names_the_term() -> None:
    wide = replace(LAYOUT, actor=(("position", 1), ("velocity", 2)))
    with pytest.raises(RealsimError, match="velocity"):
        policies.check_layout(wide, LAYOUT)
    with pytest.raises(RealsimError, match="jump"):
        policies.check_layout(replace(LAYOUT, actions=("push", "jump")), LAYOUT)
