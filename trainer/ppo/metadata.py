"""The metadata of an exported policy, checked once, against themselves and against the graph, before a robot moves."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import did_you_mean
from trainer.errors import TrainerError
from trainer.tasks import ObservationLayout

PER_JOINT = ("default", "action_scale", "kp", "kd")
NUMBERS = ("policy_dt", "depth_near", "depth_far", "action_limit")
OPTIONAL = {"depth_near": 0.0, "depth_far": 0.0, "tuned": (), "action_limit": None}
LAYOUT = ("actor", "critic", "depth", "actions", "depth_stride")
LARGEST = 1_000_000
"""Of a width or a size of an image."""


def read_metadata(text: str, version: int, path: Path) -> tuple[ObservationLayout, dict[str, Any]]:
    """(layout, the other fields of `Deployment`) of the JSON in a policy's metadata.

    Raises:
        TrainerError: broken JSON, another version, a field that is missing, unknown, or of the wrong type or length.
    """

    def refuse(what: str, expected: str, found: Any, hint: str | None = None) -> TrainerError:
        return TrainerError(
            f"the policy's metadata are damaged: {what}", file=path, expected=expected, found=_short(found), hint=hint
        )

    try:
        facts = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise refuse("they are no JSON", "what `realsim finetune` writes", error) from error
    if not isinstance(facts, dict):
        raise refuse("they are no object", "a JSON object", facts)
    if facts.get("version") != version:
        raise TrainerError(
            "the ONNX policy was written by another version",
            file=path,
            expected=f"version {version}",
            found=_short(facts.get("version")),
        )
    known = ("version", "layout", "robot", *PER_JOINT, *NUMBERS, "tuned")
    for name in facts:
        if name not in known:
            raise refuse(
                f"unknown field {_short(name)}", f"some of {', '.join(known)}", name, did_you_mean(name, known)
            )
    missing = [name for name in known if name not in facts and name not in OPTIONAL]
    if missing:
        raise refuse("fields are missing", ", ".join(missing), ", ".join(facts))
    layout = _layout(facts["layout"], refuse)
    joints = len(layout.actions)
    rest: dict[str, Any] = {}
    if not (isinstance(facts["robot"], str) and facts["robot"]):
        raise refuse("robot", "a name", facts["robot"])
    rest["robot"] = facts["robot"]
    for name in PER_JOINT:
        values = facts[name]
        if not (isinstance(values, list) and len(values) == joints and all(map(_is_number, values))):
            raise refuse(name, f"{joints} numbers, one a joint", values)
        if name in ("kp", "kd") and min(values) < 0:
            raise refuse(name, "numbers that are not negative", values)
        rest[name] = tuple(map(float, values))
    for name in NUMBERS:
        value = facts.get(name, OPTIONAL.get(name))
        if value is None and name == "action_limit":
            rest[name] = None
            continue
        if not _is_number(value) or value < 0 or (name in ("policy_dt", "action_limit") and value == 0):
            raise refuse(name, "a positive number", value)
        rest[name] = float(value)
    if not 1e-4 <= rest["policy_dt"] <= 1:
        raise refuse("policy_dt", "0.0001 to 1 s", rest["policy_dt"])
    if layout.depth is not None and not rest["depth_near"] < rest["depth_far"]:
        raise refuse("depth_near, depth_far", "near < far, metres", (rest["depth_near"], rest["depth_far"]))
    tuned = facts.get("tuned", [])
    if not (isinstance(tuned, list) and all(isinstance(t, str) for t in tuned)):
        raise refuse("tuned", "names of strategies", tuned)
    rest["tuned"] = tuple(tuned)
    return layout, rest


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
                found=_short(", ".join(f"{name} {shape} {kind}" for name, (kind, shape) in found.items())),
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


def _layout(raw: Any, refuse: Any) -> ObservationLayout:
    if not isinstance(raw, dict) or set(raw) - set(LAYOUT) or set(LAYOUT) - set(raw):
        raise refuse("layout", f"an object with {', '.join(LAYOUT)}", list(raw) if isinstance(raw, dict) else raw)
    terms = {}
    for name in ("actor", "critic"):
        rows = raw[name]
        if not (isinstance(rows, list) and rows and all(map(_is_term, rows))):
            raise refuse(f"layout.{name}", "pairs of a term's name and its width", rows)
        terms[name] = tuple((str(term), int(width)) for term, width in rows)
        if len({term for term, _ in terms[name]}) < len(rows):
            raise refuse(f"layout.{name}", "every term once", rows)
    actions, depth, stride = raw["actions"], raw["depth"], raw["depth_stride"]
    named = isinstance(actions, list) and actions and all(isinstance(a, str) and a for a in actions)
    if not named or len(set(actions)) < len(actions):
        raise refuse("layout.actions", "names of joints, every one once", actions)
    if depth is not None and not (isinstance(depth, list) and len(depth) == 3 and all(map(_is_size, depth))):
        raise refuse("layout.depth", "frames, height and width, or null", depth)
    if not (stride == 0 or _is_size(stride)) or isinstance(stride, bool):
        raise refuse("layout.depth_stride", "a whole number", stride)
    return ObservationLayout(
        terms["actor"],
        terms["critic"],
        None if depth is None else (depth[0], depth[1], depth[2]),
        tuple(actions),
        stride,
    )


def _fits(shape: list[Any], wanted: tuple[int, ...]) -> bool:
    """A dimension without a fixed size is a name, or None; the batch must take one."""
    if len(shape) != len(wanted) + 1 or (isinstance(shape[0], int) and shape[0] != 1):
        return False
    return all(not isinstance(have, int) or have == want for have, want in zip(shape[1:], wanted, strict=True))


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e9 and math.isfinite(value)


def _is_size(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 < value <= LARGEST


def _is_term(row: Any) -> bool:
    return isinstance(row, list) and len(row) == 2 and isinstance(row[0], str) and _is_size(row[1])


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 120 else text[:120] + "..."
