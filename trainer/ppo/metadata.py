"""The metadata of an exported policy, checked once, against themselves and against the graph, before a robot moves."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trainer.errors import TrainerError
from trainer.fields import brief, filled
from trainer.tasks import ObservationLayout

PER_JOINT = ("default", "action_scale", "kp", "kd")
LARGEST = 1_000_000
"""Of a width or a size of an image."""


@dataclass(frozen=True)
class Deployment:
    """Content of the metadata: how to make the inputs, and how to use the output."""

    layout: ObservationLayout
    robot: str
    policy_dt: float
    """Seconds between two actions."""
    default: tuple[float, ...]
    """(J,) rad: target = default + action_scale * action."""
    action_scale: tuple[float, ...]
    kp: tuple[float, ...]
    """(J,) N m/rad."""
    kd: tuple[float, ...]
    """(J,) N m s/rad."""
    depth_near: float = 0.0
    """Metres along the optical axis that become 0."""
    depth_far: float = 0.0
    """Metres that become 1; no measurement is 1 too."""
    tuned: tuple[str, ...] = ()
    """Strategies by which it was fine-tuned."""
    action_limit: float | None = None
    """Magnitude at which actions are clipped, in the next observation too; None in files of before it was kept."""


def read_metadata(text: str, version: int, path: Path) -> Deployment:
    """The JSON in a policy's metadata.

    Raises:
        TrainerError: broken JSON, another version, a field that is missing, unknown, or of the wrong type or length.
    """
    what = "field of the policy's metadata"
    try:
        facts = json.loads(text)
    except (ValueError, RecursionError) as error:
        expected = "JSON, as `realsim finetune` writes it"
        raise TrainerError(
            "the policy's metadata are damaged", file=path, expected=expected, found=brief(error)
        ) from error
    if isinstance(facts, dict) and (found := facts.pop("version", None)) != version:
        message = "the ONNX policy was written by another version"
        raise TrainerError(message, file=path, expected=f"version {version}", found=brief(found))
    facts = filled(Deployment, facts, what, path)
    layout, joints = facts.layout, len(facts.layout.actions)
    near, far = facts.depth_near, facts.depth_far
    rules = [
        ("robot", facts.robot != "", "a name"),
        ("policy_dt", 1e-4 <= facts.policy_dt <= 1, "0.0001 to 1 s"),
        ("action_limit", facts.action_limit is None or facts.action_limit > 0, "a positive number"),
        ("depth_near, depth_far", 0 <= near <= far and (layout.depth is None or near < far), "near < far, metres"),
        ("layout.actions", 0 < joints == len(set(layout.actions)), "names of joints, every one once"),
        ("layout.depth", all(0 < size <= LARGEST for size in layout.depth or ()), "frames, height and width"),
        ("layout.depth_stride", 0 <= layout.depth_stride <= LARGEST, "a whole number"),
    ]
    rules += [(name, len(getattr(facts, name)) == joints, f"{joints} numbers, one a joint") for name in PER_JOINT]
    rules += [
        (name, min(getattr(facts, name)) >= 0, "numbers that are not negative") for name in ("kp", "kd") if joints
    ]
    for name, terms in (("layout.actor", layout.actor), ("layout.critic", layout.critic)):
        right = terms and all(0 < w <= LARGEST for _, w in terms) and len({n for n, _ in terms}) == len(terms)
        rules.append((name, bool(right), "pairs of a term's name and its width, every term once"))
    for name, right, expected in rules:
        if not right:
            raise TrainerError(f"the policy's metadata are damaged: {name}", file=path, expected=expected)
    return facts


def check_graph(runtime: Any, layout: ObservationLayout, path: Path) -> None:
    """The graph takes and gives what the metadata say.

    Args:
        runtime: an onnxruntime session.

    Raises:
        TrainerError: other names, types or shapes.
    """
    wanted: dict[str, tuple[int, ...]] = {"vector": (layout.actor_width,)}
    if layout.depth is not None:
        wanted["depth"] = layout.depth
    sides = (
        ("inputs", wanted, runtime.get_inputs()),
        ("output", {"action": (len(layout.actions),)}, runtime.get_outputs()),
    )
    for side, want, have in sides:
        found = {node.name: (node.type, list(node.shape)) for node in have}
        fits = set(found) == set(want) and all(
            found[name][0] == "tensor(float)" and _fits(found[name][1], shape) for name, shape in want.items()
        )
        if not fits:
            raise TrainerError(
                f"the network's {side} are not those of its metadata"
                if side == "inputs"
                else "the network's output is not that of its metadata",
                file=path,
                expected=", ".join(f"{name} (any, {', '.join(map(str, shape))}) float" for name, shape in want.items()),
                found=brief(", ".join(f"{name} {shape} {kind}" for name, (kind, shape) in found.items())),
                hint="export the policy again",
            )


def check_network(runtime: Any, layout: ObservationLayout, path: Path | None = None) -> None:
    """The network runs: an observation of zeros gives one action a joint.

    Raises:
        TrainerError: it fails, as networks with a damaged tensor do only now, or gives another number of actions.
    """
    inputs = {"vector": np.zeros((1, layout.actor_width), np.float32)}
    if layout.depth is not None:
        inputs["depth"] = np.ones((1, *layout.depth), np.float32)
    expected = f"{len(layout.actions)} actions for an observation of zeros"
    try:
        shape = np.shape(runtime.run(None, inputs)[0])
    except Exception as error:  # onnxruntime's own exception classes share no base but this
        raise TrainerError(
            "the policy cannot be run: its network is damaged",
            file=path,
            expected=expected,
            found=str(error).partition("\n")[0],
            hint="export it again",
        ) from error
    if shape != (1, len(layout.actions)):
        message = "the policy gives another number of actions than its metadata say"
        raise TrainerError(message, file=path, expected=expected, found=f"{shape}", hint="export it again")


def _fits(shape: list[Any], wanted: tuple[int, ...]) -> bool:
    """A dimension without a fixed size is a name, or None; the batch must take one."""
    if len(shape) != len(wanted) + 1 or (isinstance(shape[0], int) and shape[0] != 1):
        return False
    return all(not isinstance(have, int) or have == want for have, want in zip(shape[1:], wanted, strict=True))
