"""Every length, type and name of an exported policy is checked before a robot moves."""

import copy
import json
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from trainer.errors import TrainerError
from trainer.ppo.export import VERSION, Deployment
from trainer.ppo.metadata import check_graph, read_metadata
from trainer.tasks import ObservationLayout

LAYOUT = ObservationLayout((("gravity", 3), ("joint_pos", 4)), (("gravity", 3),), (2, 4, 6), ("hip", "knee"), 2)
GOOD = {
    "version": VERSION,
    **asdict(Deployment(LAYOUT, "walker", 0.02, *[(0.1, 0.2)] * 4, depth_near=0.1, depth_far=2.0, tuned=("lora",))),
}
PATH = Path("policy.onnx")


def test_what_export_writes_is_read_back() -> None:
    found = read_metadata(json.dumps(GOOD), VERSION, PATH)
    assert found.layout == LAYOUT
    assert {"version": VERSION, **asdict(found)} == GOOD
    old = {k: v for k, v in GOOD.items() if k not in ("action_limit", "tuned")}
    assert read_metadata(json.dumps(old), VERSION, PATH).action_limit is None


BAD: list[tuple[str, Any]] = [
    ("version", 2), ("robot", 3), ("robot", ""), ("kp", [1.0]), ("kp", [1.0, "2"]), ("kp", [1.0, -2.0]), ("kd", None),
    ("default", [[0.1, 0.2]]), ("default", [0.1, float("nan")]), ("action_scale", 0.5), ("policy_dt", 0),
    ("policy_dt", "x"), ("policy_dt", True), ("depth_far", 0.05), ("action_limit", -1), ("tuned", "lora"),
    ("unknown", 1), ("layout", []), ("layout.actor", [["gravity"]]), ("layout.actor", [["gravity", 1.5]]),
    ("layout.actor", [["gravity", 3], ["gravity", 3]]), ("layout.critic", None), ("layout.depth", [2, 4]),
    ("layout.depth", [2, 4, -6]), ("layout.depth", "2x4x6"), ("layout.actions", ["hip", "hip"]),
    ("layout.actions", []), ("layout.depth_stride", -1), ("layout.depth_stride", 1.5), ("layout.more", 1),
]  # fmt: skip


@pytest.mark.parametrize(("field", "value"), BAD)
def test_a_wrong_field_is_named(field: str, value: Any) -> None:
    facts = copy.deepcopy(json.loads(json.dumps(GOOD)))
    first, _, second = field.partition(".")
    if second:
        facts[first][second] = value
    else:
        facts[first] = value
    with pytest.raises(TrainerError) as error:
        read_metadata(json.dumps(facts), VERSION, PATH)
    assert second in str(error.value)
    assert "policy.onnx" in str(error.value)


@pytest.mark.parametrize("text", ["", "[]", "{", "[" * 100_000, "null"])
def test_no_object_at_all(text: str) -> None:
    with pytest.raises(TrainerError):
        read_metadata(text, VERSION, PATH)


def graph(inputs: dict[str, list[Any]], outputs: dict[str, list[Any]], kind: str = "tensor(float)") -> SimpleNamespace:
    nodes = [[SimpleNamespace(name=n, shape=s, type=kind) for n, s in side.items()] for side in (inputs, outputs)]
    return SimpleNamespace(get_inputs=lambda: nodes[0], get_outputs=lambda: nodes[1])


INPUTS = {"vector": ["batch", 7], "depth": ["batch", 2, 4, 6]}


def test_the_graph_must_fit() -> None:
    check_graph(graph(INPUTS, {"action": ["batch", 2]}), LAYOUT, PATH)
    check_graph(graph({"vector": [1, None], "depth": [1, 2, 4, 6]}, {"action": [1, 2]}), LAYOUT, PATH)
    for wrong in (
        graph(INPUTS | {"vector": ["batch", 8]}, {"action": ["batch", 2]}),
        graph(INPUTS | {"vector": [4, 7]}, {"action": ["batch", 2]}),
        graph({"vector": ["batch", 7]}, {"action": ["batch", 2]}),
        graph(INPUTS, {"action": ["batch", 3]}),
        graph(INPUTS, {"actions": ["batch", 2]}),
        graph(INPUTS, {"action": ["batch", 2]}, "tensor(double)"),
    ):
        with pytest.raises(TrainerError, match="metadata"):
            check_graph(wrong, LAYOUT, PATH)
