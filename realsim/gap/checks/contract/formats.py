"""Where a contract is written down: metadata of `realsim finetune` or of mjlab (and of Isaac Lab projects that attach
the same) in the ONNX file; deploy.yaml of unitree_rl_lab; IO_descriptors.yaml of Isaac Lab."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError, ModelError
from realsim.core.files import parse_yaml, read_text
from realsim.core.onnx_file import open_network, open_session, with_any_batch
from realsim.core.types import F64
from realsim.gap.checks.contract.policy import TERMS, WIDTH, Camera, Contract, Run, Term

EXPORTED = "give the exported policy.onnx, which realsim finetune and mjlab write, and play.py of Isaac Lab"
MAX_BYTES = 2**20
"""Of a YAML file: deploy.yaml of a humanoid has 10 kB."""


def read_contract(path: Path, meta: Mapping[str, str], deploy: Path | None, joints: Sequence[str]) -> Contract:
    """See `load_policy`; the network is not looked at. Raises GapError."""
    try:
        if deploy is not None:
            content = parse_yaml(read_text(deploy, MAX_BYTES), deploy)
            if not isinstance(content, dict):
                raise GapError("the YAML file is no map", file=deploy, found=type(content).__name__)
            if "joint_ids_map" in content:
                return _of_deploy_yaml(content, joints)
            if "articulations" in content:
                return _of_io_descriptors(content)
            raise GapError(
                "this YAML file is no contract of a policy", file=deploy,
                expected="deploy.yaml of unitree_rl_lab (joint_ids_map, ...) or Isaac Lab's IO_descriptors.yaml",
                found=", ".join(map(str, list(content)[:8])) or "nothing",
            )  # fmt: skip
        if "realsim" in meta:
            return _of_realsim(json.loads(meta["realsim"]))
        if "joint_names" in meta:
            return _of_mjlab(meta)
    except KeyError as error:
        raise GapError(
            f"the policy's contract cannot be read: {error.args[0]!r} is missing", file=deploy or path
        ) from error
    except (TypeError, ValueError, AttributeError, IndexError, RecursionError) as error:
        raise GapError("the policy's contract cannot be read", file=deploy or path, found=str(error)[:200]) from error
    raise GapError(
        "the policy does not describe its observations", file=path,
        expected="metadata of realsim or mjlab, or --deploy-yaml", found=", ".join(meta)[:200] or "no metadata",
        hint="unitree_rl_lab writes params/deploy.yaml beside the export, Isaac Lab params/IO_descriptors.yaml; "
        "of another trainer, add mjlab's metadata: joint_names, observation_names, default_joint_pos, action_scale, "
        "joint_stiffness, joint_damping, each a list by commas (docs/diagnose.md)",
    )  # fmt: skip


def _terms(items: Iterable[tuple[str, int | None, int, Any]], joints: int) -> tuple[Term, ...]:
    """Terms from (name, width of all moments if known, history, scale)."""
    found = []
    for name, size, history, scale in items:
        kind = TERMS.get(name, "unknown")
        width = WIDTH.get(kind, joints) if kind != "unknown" else size
        if width is None:
            raise ValueError(f"unknown observation term {name!r} of unknown width: known are {', '.join(TERMS)}")
        if size is not None and kind != "unknown":
            if size % width:
                raise ValueError(f"{name} is {size} wide, which is no multiple of {width}")
            history = size // width
        scales = np.atleast_1d(np.asarray(1.0 if scale is None else scale, dtype=np.float64))
        if not np.isfinite(scales).all() or len(scales) not in (1, width):
            raise ValueError(f"{name} has {len(scales)} scales for {width} columns")
        found.append(Term(name, kind, width, max(history, 1), float(scales[0]) if len(set(scales)) == 1 else scales))
    if not found:
        raise ValueError("no observation term")
    return tuple(found)


def _array(values: Any, count: int) -> F64:
    found = np.broadcast_to(np.asarray(values, dtype=np.float64), (count,)).copy()
    if not np.isfinite(found).all():
        raise ValueError("a figure is not finite")
    return found


def _share(value: Any) -> float:
    if not 0 < (share := float(value)) <= 1:
        raise ValueError(f"alpha, the new target's share in a low pass, is {share:g}: expected above 0, at most 1")
    return share


def _of_realsim(facts: Mapping[str, Any]) -> Contract:
    layout = facts["layout"]
    joints = tuple(layout["actions"])
    n = len(joints)
    depth = layout.get("depth")
    camera = None
    if depth is not None:
        frames, height, width = map(int, depth)
        camera = Camera((frames, height, width), max(int(layout.get("depth_stride", 1)), 1),
                        float(facts["depth_near"]), float(facts["depth_far"]))  # fmt: skip
    return Contract(
        joints, _terms([(name, int(width), 1, 1.0) for name, width in layout["actor"]], n),
        _array(facts["default"], n), _array(facts["action_scale"], n), _array(facts["kp"], n), _array(facts["kd"], n),
        float(facts["policy_dt"]), facts.get("action_limit"), camera=camera,
    )  # fmt: skip


def _of_mjlab(meta: Mapping[str, str]) -> Contract:
    """Lists separated by commas; observation_history_lengths and observation_scales where a project adds them."""
    joints = tuple(name.strip() for name in meta["joint_names"].split(","))
    n = len(joints)

    def numbers(key: str, count: int = n) -> F64:
        return _array([float(v) for v in meta[key].split(",")], count)

    names = [name.strip() for name in meta["observation_names"].split(",")]
    m = len(names)
    histories = numbers("observation_history_lengths", m) if "observation_history_lengths" in meta else np.ones(m)
    scales = numbers("observation_scales", m) if "observation_scales" in meta else np.ones(m)
    terms = _terms([(a, None, int(b), c) for a, b, c in zip(names, histories, scales, strict=True)], n)
    return Contract(
        joints, terms, numbers("default_joint_pos"), numbers("action_scale"), numbers("joint_stiffness"),
        numbers("joint_damping"), float(meta.get("step_dt", 0.02)), alpha=_share(meta.get("action_alpha", 1.0)),
        framework="mjlab",
    )  # fmt: skip


def _of_deploy_yaml(content: Mapping[str, Any], motors: Sequence[str]) -> Contract:
    """deploy.yaml as unitree_rl_lab's export_deploy_cfg writes it: `joint_ids_map` is the motor of each of the policy's
    joints; default_joint_pos, scale and offset are in the policy's order, stiffness and damping in the motors'."""
    ids = [int(i) for i in content["joint_ids_map"]]
    if not ids or min(ids) < 0 or max(ids) >= len(motors):
        raise ValueError(f"joint_ids_map names motor {max(ids, default=None)}, the log has {len(motors)} joints")
    actions = content["actions"]
    if not isinstance(actions, Mapping) or list(actions) != ["JointPositionAction"]:
        raise ValueError(f"actions: expected JointPositionAction alone, found {', '.join(map(str, actions))}")
    action = actions["JointPositionAction"]
    default = _array(content["default_joint_pos"], len(ids))
    moved = action.get("joint_ids")
    if moved is not None and list(moved) != list(range(len(ids))):
        raise ValueError("joint_ids: a policy that moves only some of its joints is not supported")
    items = []
    for name, term in content["observations"].items():
        scale = term.get("scale")
        known = TERMS.get(name) is not None
        size = None if known else len(np.atleast_1d(1.0 if scale is None else scale))
        items.append((name, size, int(term.get("history_length") or 1), scale))
    clip = action.get("clip")
    offset = action.get("offset")
    return Contract(
        tuple(motors[i] for i in ids), _terms(items, len(ids)), default, _array(action["scale"], len(ids)),
        _array(content["stiffness"], len(motors))[ids], _array(content["damping"], len(motors))[ids],
        float(content["step_dt"]), None if clip is None else float(np.max(np.abs(clip))),
        offset=None if offset is None else _array(offset, len(ids)), framework="unitree",
    )  # fmt: skip


def _of_io_descriptors(content: Mapping[str, Any]) -> Contract:
    """IO_descriptors.yaml of Isaac Lab 2.2 and later: one joint position action, one group of observations."""
    (action,) = content["actions"]
    (robot,) = content["articulations"].values()
    joints = tuple(map(str, action["joint_names"]))
    own = {str(name): i for i, name in enumerate(robot["joint_names"])}
    at = [own[j] for j in joints]
    groups = content["observations"]
    group = groups["policy"] if "policy" in groups else next(iter(groups.values()))
    items = []
    for term in group:
        more = term.get("overloads") or {}
        width = int(np.prod([int(s) for s in term["shape"]]))
        items.append((str(term["name"]), width, int(more.get("history_length") or 1), more.get("scale")))

    def of(key: str) -> F64:
        return _array(robot[key], len(own))[at]

    return Contract(
        joints, _terms([(a, None if a in TERMS else b, c, d) for a, b, c, d in items], len(joints)),
        of("default_joint_pos"), _array(action["scale"], len(joints)), of("default_joint_stiffness"),
        of("default_joint_damping"), float(content["scene"]["dt"]), offset=_array(action["offset"], len(joints)),
        alpha=_share(action.get("alpha", 1.0)), framework="isaaclab",
    )  # fmt: skip


def load_policy(path: Path | str, deploy: Path | str | None = None, joints: Sequence[str] = ()) -> Contract:
    """The contract of a policy.

    Args:
        path: policy.onnx; weights in another file are looked for beside it.
        deploy: deploy.yaml of unitree_rl_lab, or IO_descriptors.yaml of Isaac Lab, where the ONNX file has no metadata.
        joints: names of the motors in the robot's order, which deploy.yaml does not know; those of the log.

    Raises:
        GapError: no ONNX, no contract in it, or one that does not fit the network.
    """
    path, deploy = Path(path), Path(deploy) if deploy is not None else None
    if path.is_dir():
        raise GapError("a folder, not a policy", file=path, expected="policy.onnx", hint=f"give {path / 'policy.onnx'}")
    try:
        session = open_network(path)
    except ModelError as error:
        absent = "beside" in (error.hint or "") + (error.expected or "")
        raise GapError(
            f"not a readable ONNX policy: {error.message}", file=path, expected=error.expected, found=error.found,
            hint=error.hint if absent else EXPORTED,
        ) from error  # fmt: skip
    made = read_contract(path, session.get_modelmeta().custom_metadata_map, deploy, joints)
    # `Contract.run`; run once on zeros, so that a damaged network is refused here.
    inputs = session.get_inputs()
    vector, images = inputs[0], inputs[1:]
    size = vector.shape[-1]
    if isinstance(size, int) and size != made.width:
        raise GapError(
            "the contract does not fit the network", file=path, expected=f"{size} numbers of observation",
            found=f"{made.width}: " + " + ".join(f"{t.history} x {t.width} {t.name}" for t in made.terms),
        )  # fmt: skip
    if len(images) != (made.camera is not None):
        raise GapError(
            "the policy has inputs that its contract does not describe", file=path,
            expected=f"{vector.name}" + (" and a depth image" if made.camera else ""),
            found=", ".join(i.name for i in inputs),
            hint="policies with a clock, a motion reference or a memory of their own cannot be replayed step by step",
        )  # fmt: skip
    call = _batch(session)
    if isinstance(vector.shape[0], int):
        call = _for_one(session, path, made)
    try:
        shape = call(np.zeros((1, made.width)), np.ones((1, *made.camera.shape)) if made.camera else None).shape
    except Exception as error:  # onnxruntime's own exception classes share no base but this
        raise GapError(
            "the policy cannot be run", file=path, expected=f"{len(made.joints)} actions for an observation of zeros",
            found=str(error).partition("\n")[0],
        ) from error  # fmt: skip
    if shape != (1, len(made.joints)):
        raise GapError(
            "the contract does not fit the network", file=path, expected=f"{len(made.joints)} actions",
            found=f"an output of {shape}",
        )  # fmt: skip
    return replace(made, run=call)


def _batch(session: Any) -> Run:
    """The network's first output for all rows at once."""
    names = [i.name for i in session.get_inputs()]

    def call(rows: F64, pictures: F64 | None) -> F64:
        values = (rows,) if pictures is None else (rows, pictures)
        feeds = {name: np.ascontiguousarray(v, np.float32) for name, v in zip(names, values, strict=True)}
        return np.asarray(session.run(None, feeds)[0], dtype=np.float64)

    return call


def _for_one(session: Any, path: Path, made: Contract) -> Run:
    """A network that was exported for one observation at a time, as Isaac Lab does: all rows at once where it gives the
    same for three of them (a check asks for millions), one after the other where it does not."""
    one = _batch(session)

    def each(rows: F64, pictures: F64 | None) -> F64:
        return np.concatenate([one(rows[[i]], None if pictures is None else pictures[[i]]) for i in range(len(rows))])

    rng = np.random.default_rng(0)
    pictures = rng.uniform(size=(3, *made.camera.shape)) if made.camera else None
    try:
        every = _batch(open_session(path, with_any_batch(path)))
        rows = rng.normal(size=(3, made.width))
        return every if np.allclose(every(rows, pictures), each(rows, pictures), atol=1e-5) else each
    except Exception:  # an operator that cannot take many rows: onnxruntime's own classes, which share no base but this
        return each  # what is wrong with the network itself is named where it is run on zeros
