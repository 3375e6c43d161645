"""A gap diagnosis as randomisation: ranges about what was found replace those that had to be guessed.

What ranges of a world can hold becomes a range, its 90 percent interval. What only a model can hold (where a load sits,
the torque limit of a weaker motor, viscous friction) goes into the robot's model by the diagnosis' own patch, and the
ranges beside it are then about the patched value. Where the data cannot tell sets of causes apart, each world draws one
of the sets, and the model takes what they share.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import RealsimError
from realsim.core.files import read_json
from realsim.core.geometry import R_to_quat, exp_so3, quat_to_R
from trainer.errors import TrainerError
from trainer.robots import TrainedRobot
from trainer.robots.base import DepthMount
from trainer.tasks.parkour.config import Range
from trainer.tasks.parkour.randomise import Known

Interval = Callable[[str], Range | None]
"""Name of a parameter -> its 90 percent interval, None if the cause does not have it."""
TAKEN = ("identified", "ambiguous", "partly_explained")
"""Verdicts whose causes hold on the check. Those of `unexplained` are the nearest that was tried, and wrong."""
CAMERA = ("camera_delay", "camera_mount", "depth_noise")
"""Effects that recorded depth tells, whatever the verdict on the motion (`realsim.gap.answer.camera`)."""
OPENCV_IN_MOUNT = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""Columns: a camera's x (right), y (down), z (forward) in the axes of a `DepthMount` (x forward, y left, z up)."""


def load(path: str | Path, robot: TrainedRobot) -> Known:
    """What a diagnosis knows about this robot.

    Effects that the task has no place for come back in `unused`, and so do parts of effects, as `imu_bias (acc_x)`; of
    a verdict that names no cause, all of them.

    Args:
        path: `diagnosis.json`, or the folder that it is in.

    Raises:
        TrainerError: not a diagnosis, or of a robot with other joints.
    """
    path = Path(path) / "diagnosis.json" if Path(path).is_dir() else Path(path)
    data = read_json(path)
    if not isinstance(data, dict) or not isinstance(data.get("causes"), list) or "verdict" not in data:
        raise TrainerError("not a diagnosis", file=path, expected="diagnosis.json of `realsim diagnose`")
    try:
        seen = [c for c in data["causes"] if c.get("effect") in CAMERA]
        taken = data["verdict"] in TAKEN
        left = () if taken else tuple(f"{c.get('effect')} ({data['verdict']})" for c in data["causes"] if c not in seen)
        sets = [data["causes"], *(s + seen for s in data.get("equivalent", ()))] if taken else [seen]
        held = _held_by_model(sets, data.get("patch"), robot, path)
        alternatives = tuple(_known(causes, robot, held, path) for causes in sets)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise TrainerError(
            "the diagnosis is damaged", file=path, found=f"{type(error).__name__}: {error}", hint="diagnose again"
        ) from error
    unused = tuple(dict.fromkeys([*left, *(u for known in alternatives for u in known.unused)]))
    model = data["patch"] | {"settings": held} if held else None
    first = replace(alternatives[0], unused=unused, model=model)
    return first if len(alternatives) == 1 else replace(first, alternatives=alternatives)


def alone(path: Path) -> dict[str, dict[str, Any]]:
    """Title -> the diagnosis as if that cause were the only one; of a sure set of causes, or the first of several.

    Raises:
        TrainerError: not a diagnosis.
    """
    path = path / "diagnosis.json" if path.is_dir() else path
    data = read_json(path)
    if not isinstance(data, dict) or not isinstance(data.get("causes"), list):
        raise TrainerError("not a diagnosis", file=path, expected="diagnosis.json of `realsim diagnose`")
    patch, found = data.get("patch"), {}
    for cause in data["causes"]:
        effect, place = _name(cause)
        mine = None
        if isinstance(patch, dict):
            settings = [s for s in patch.get("settings", ()) if (s["effect"], tuple(s["place"])) == (effect, place)]
            mine = patch | {"settings": settings}
        title = f"{effect} of {', '.join(place)}" if place else effect
        found[title] = data | {"causes": [cause], "equivalent": [], "patch": mine}
    return found


def patched(robot: TrainedRobot, known: Known) -> TrainedRobot:
    """The robot with the part of the diagnosis that only a model can hold, and its camera where it was found."""
    if known.model is not None:
        from realsim.gap import apply_patch

        spec = robot.robot.spec.copy()
        apply_patch(spec, known.model)
        robot = replace(robot, robot=replace(robot.robot, spec=spec))
    if known.mount is not None and robot.camera is not None:
        robot = replace(robot, camera=_moved(robot.camera, known.mount))
    return robot


def _moved(camera: DepthMount, mount: tuple[Range, ...]) -> DepthMount:
    """The mount turned and shifted by the middle of six ranges (rad, m; the camera's axes)."""
    middle = np.array([sum(bounds) / 2 for bounds in mount])
    R = quat_to_R(camera.quat)
    turned = R @ exp_so3(OPENCV_IN_MOUNT @ middle[:3])
    return replace(camera, pos=camera.pos + R @ OPENCV_IN_MOUNT @ middle[3:], quat=R_to_quat(turned))


def _held_by_model(
    sets: list[list[dict[str, Any]]], patch: Any, robot: TrainedRobot, path: Path
) -> list[dict[str, Any]]:
    """Settings of the patch for causes in all sets that ranges cannot hold whole, and a model of this robot can."""
    shared = {_name(c) for c in sets[0]}.intersection(*({_name(c) for c in s} for s in sets))
    whole = {_name(c) for c in sets[0] if not _left(c, robot, path)}
    settings = patch.get("settings", ()) if isinstance(patch, dict) else ()
    wanted = shared - whole
    return [s for s in settings if (s["effect"], tuple(s["place"])) in wanted and _fits(s, patch, robot)]


def _fits(setting: dict[str, Any], patch: dict[str, Any], robot: TrainedRobot) -> bool:
    """Whether the trainer's robot can be changed so: its own parts, no joints added, nothing left for a wrapper."""
    from realsim.gap import apply_patch
    from realsim.gap.effects import EFFECTS

    effect = EFFECTS[setting["effect"]]
    if effect.scope not in ("joint", "body") or not effect.patchable:
        return False
    spec = robot.robot.spec.copy()
    try:
        signals = apply_patch(spec, patch | {"settings": [setting]})
        spec.compile()
    except (RealsimError, KeyError, ValueError):
        return False  # a body of the scene, or of a model with other names
    return not (signals.rotors or signals.pulses or signals.moves_the_robot())


def _name(cause: dict[str, Any]) -> tuple[str, tuple[str, ...]]:
    return str(cause.get("effect")), tuple(cause.get("joints") or cause.get("bodies") or ())


def _known(causes: list[dict[str, Any]], robot: TrainedRobot, held: list[dict[str, Any]], path: Path) -> Known:
    """Ranges of one set of causes; what the model holds has them about the patched value."""
    found = _Found()
    names = {(s["effect"], tuple(s["place"])) for s in held}
    for cause in causes:
        if _name(cause) not in names:
            _take(cause, robot, found, path)
        elif cause["effect"] in _ABOUT and _torsos(cause, robot):
            _take(_about(cause), robot, _Found(found.ranges, [], found.servo), path)
    return Known(**found.ranges, unused=tuple(found.unused), servo=frozenset(found.servo))


@dataclass
class _Found:
    """What has been taken of a set of causes so far."""

    ranges: dict[str, Any] = field(default_factory=dict)
    unused: list[str] = field(default_factory=list)
    servo: set[int] = field(default_factory=set)


def _left(cause: dict[str, Any], robot: TrainedRobot, path: Path) -> list[str]:
    """What ranges cannot hold of a cause."""
    found = _Found()
    _take(cause, robot, found, path)
    return found.unused


def _about(cause: dict[str, Any]) -> dict[str, Any]:
    """A cause that the model has at its value, with only its strength's interval, about that value."""
    name, about = _ABOUT[cause["effect"]]
    p = cause["parameters"][name]
    ends = [about(float(v), float(p["value"])) for v in p["ci90"]]
    return cause | {"parameters": {name: {"ci90": ends}}}


def _take(cause: dict[str, Any], robot: TrainedRobot, found: _Found, path: Path) -> None:
    effect, joints = str(cause.get("effect")), cause.get("joints") or []
    unknown = [j for j in joints if j not in robot.joints]
    if unknown:
        raise TrainerError(
            "the diagnosis belongs to another robot",
            file=path,
            expected=f"joints of {robot.robot.name}",
            found=f"no joint {unknown[0]!r}",
            hint=f"diagnose a log of {robot.robot.name}, or give the policy of the robot that was diagnosed",
        )
    places = [robot.joints.index(j) for j in joints] or list(range(len(robot.joints)))
    left = dict(cause.get("parameters", {}))  # what nobody asks for is named as unused

    def interval(name: str) -> Range | None:
        value = cause.get("parameters", {}).get(name)
        left.pop(name, None)
        if value is None:
            return None
        low, high = map(float, value["ci90"])
        if not -inf < low <= high < inf:
            raise TrainerError(
                "an interval of the diagnosis is upside down or not finite",
                file=path,
                expected=f"ci90 of {effect}, {name}: [low, high]",
                found=str(value["ci90"]),
            )
        return low, high

    if effect in _JOINT:
        if effect == "joint_offset" and interval("offset") is not None:
            found.servo.update(places)
        for key, of in _JOINT[effect].items():
            own = found.ranges.setdefault(key, {})
            for j in places:
                bounds = of(interval, robot, j)
                if bounds is None:
                    left[robot.joints[j]] = None
                else:
                    low, high = own.get(j, (1.0, 1.0)) if key in ("kp", "kd") else (1.0, 1.0)
                    own[j] = low * bounds[0], high * bounds[1]
    elif effect in _WHOLE and (effect not in ("payload", "com_offset") or _torsos(cause, robot)):
        found.ranges.update({k: v for k, v in _WHOLE[effect](interval).items() if v is not None})
        if effect == "ground_friction" and "friction" in found.ranges:
            low, high = found.ranges["friction"]
            nominal = _nominal_friction(robot)
            found.ranges["friction"] = (low * nominal, high * nominal)
    elif effect == "terrain_height" and (height := interval("height")) is not None:
        found.ranges.setdefault("heights", {}).update(dict.fromkeys(cause.get("bodies") or (), height))
    else:
        found.unused.append(effect)
        return
    parts = [*left, *_NOT_SIMULATED.get(effect, ())]
    if parts:
        found.unused.append(f"{effect} ({', '.join(parts)})")


def _torsos(cause: dict[str, Any], robot: TrainedRobot) -> bool:
    """Whether a cause acts on the bodies whose mass worlds can differ in, or on joints."""
    return all(b in (robot.torso, robot.base) for b in cause.get("bodies") or [robot.torso])


def _nominal_friction(robot: TrainedRobot) -> float:
    """Sliding friction of feet on terrain in the robot's model: MuJoCo takes the larger of the two; terrain has 1."""
    spec = robot.robot.spec
    return max(1.0, *(float(g.friction[0]) for foot in robot.feet for g in spec.body(foot).geoms))


def _armature(interval: Interval, robot: TrainedRobot, j: int) -> Range | None:
    """kg m^2 added, as a ratio on the joint's own."""
    added = interval("armature")
    own = float(robot.robot.spec.joint(robot.joints[j]).armature)
    return None if added is None or own <= 0 else (1 + added[0] / own, 1 + added[1] / own)


_JOINT: dict[str, dict[str, Callable[[Interval, TrainedRobot, int], Range | None]]] = {
    "stiffness_gain": {"kp": lambda interval, robot, j: interval("ratio")},
    "damping_gain": {"kd": lambda interval, robot, j: interval("ratio")},
    # A weak motor gives a share of the whole servo torque.
    "motor_gain": {key: lambda interval, robot, j: interval("ratio") for key in ("kp", "kd")},
    "armature": {"armature": _armature},
    "coulomb_friction": {"joint_friction": lambda interval, robot, j: interval("friction")},
    "joint_offset": {"encoder": lambda interval, robot, j: interval("offset") or interval("reading_offset")},
}

_NOT_SIMULATED = {"motor_gain": ("force limit",)}
"""Effect -> what it changes on the robot beside what is taken from it."""
_ABOUT: dict[str, tuple[str, Callable[[float, float], float]]] = {
    "motor_gain": ("ratio", lambda end, value: end / value),
    "payload": ("mass", lambda end, value: end - value),
}
"""Effect that the model has at its value -> (parameter whose interval worlds draw from, an end of it about that)."""


def _axes(interval: Interval, *names: str) -> tuple[Range, ...] | None:
    """The intervals, nothing where one is absent; None where all are: the cause says nothing about them."""
    found = [interval(name) for name in names]
    return tuple(bounds or (0.0, 0.0) for bounds in found) if any(found) else None


_WHOLE: dict[str, Callable[[Interval], dict[str, Any]]] = {
    "command_delay": lambda interval: {"delay": interval("delay")},
    "camera_delay": lambda interval: {"depth_latency": interval("delay")},
    "ground_friction": lambda interval: {"friction": interval("ratio")},
    "contact_compliance": lambda interval: {"contact_time": interval("time_constant")},
    "payload": lambda interval: {"payload": interval("mass")},
    "com_offset": lambda interval: {"com": _axes(interval, "x", "y", "z")},
    "terrain_scale": lambda interval: {"terrain_scale": interval("ratio")},
    "imu_bias": lambda interval: {"gyro": _axes(interval, "gyro_x", "gyro_y", "gyro_z")},
    "camera_mount": lambda interval: {
        "mount": _axes(interval, "turn_x", "turn_y", "turn_z", "shift_x", "shift_y", "shift_z")
    },
    "depth_noise": lambda interval: {"depth_noise": interval("ratio")},
}
