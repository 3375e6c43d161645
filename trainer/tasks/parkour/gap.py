"""A gap diagnosis as ranges of the domain randomisation: what was identified replaces what had to be guessed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from realsim.files import read_json
from trainer.errors import TrainerError
from trainer.robots import TrainedRobot
from trainer.tasks.parkour.config import Range
from trainer.tasks.parkour.randomise import Known

Interval = Callable[[str], Range | None]
"""Name of a parameter -> its 90 percent interval, None if the cause does not have it."""


def load(path: str | Path, robot: TrainedRobot) -> Known:
    """What `diagnosis.json` knows about this robot.

    Only the causes of an `identified` verdict are taken: an ambiguous set is one guess of several. Effects that the
    task has no place for come back in `unused`, and so do parts of effects, as `payload (x, y, z)`.

    Raises:
        TrainerError: not a diagnosis, or of a robot with other joints.
    """
    data = read_json(Path(path))
    if not isinstance(data, dict) or not isinstance(data.get("causes"), list) or "verdict" not in data:
        raise TrainerError("not a diagnosis", file=path, expected="diagnosis.json of `realsim diagnose`")
    found: dict[str, Any] = {"unused": [], "servo": set()}
    try:
        if data["verdict"] != "identified":
            return Known(unused=tuple(f"{c.get('effect')} ({data['verdict']})" for c in data["causes"]))
        for cause in data["causes"]:
            _take(cause, robot, found, path)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise TrainerError(
            "the diagnosis is damaged", file=path, found=f"{type(error).__name__}: {error}", hint="diagnose again"
        ) from error
    return Known(**found | {"unused": tuple(found["unused"]), "servo": frozenset(found["servo"])})


def _take(cause: dict[str, Any], robot: TrainedRobot, found: dict[str, Any], path: str | Path) -> None:
    effect, joints = str(cause.get("effect")), cause.get("joints") or []
    unknown = [j for j in joints if j not in robot.joints]
    if unknown:
        raise TrainerError(
            "the diagnosis belongs to another robot",
            file=path,
            expected=f"joints of {robot.robot.name}",
            found=f"no joint {unknown[0]!r}",
        )
    places = [robot.joints.index(j) for j in joints] or list(range(len(robot.joints)))
    left = dict(cause.get("parameters", {}))  # what nobody asks for is named as unused

    def interval(name: str) -> Range | None:
        value = cause.get("parameters", {}).get(name)
        left.pop(name, None)
        return None if value is None else (float(value["ci90"][0]), float(value["ci90"][1]))

    if effect in _JOINT:
        if effect == "joint_offset" and interval("offset") is not None:
            found["servo"].update(places)
        for key, of in _JOINT[effect].items():
            own = found.setdefault(key, {})
            for j in places:
                bounds = of(interval, robot, j)
                if bounds is None:
                    left[robot.joints[j]] = None
                else:
                    own[j] = _product(own[j], bounds) if j in own and key in ("kp", "kd") else bounds
    elif effect in _WHOLE and (effect not in ("payload", "com_offset") or _on_torso(cause, robot)):
        found.update({k: v for k, v in _WHOLE[effect](interval).items() if v is not None})
    else:
        found["unused"].append(effect)
        return
    parts = [*left, *_NOT_SIMULATED.get(effect, ())]
    if parts:
        found["unused"].append(f"{effect} ({', '.join(parts)})")


def _on_torso(cause: dict[str, Any], robot: TrainedRobot) -> bool:
    return all(b in (robot.torso, robot.base) for b in cause.get("bodies") or [robot.torso])


def _product(a: Range, b: Range) -> Range:
    return a[0] * b[0], a[1] * b[1]


def _armature(interval: Interval, robot: TrainedRobot, j: int) -> Range | None:
    """kg m^2 added, as a ratio on the joint's own."""
    added = interval("armature")
    own = float(robot.robot.spec.joint(robot.joints[j]).armature)
    return None if added is None or own <= 0 else (1 + added[0] / own, 1 + added[1] / own)


def _offset(interval: Interval, robot: TrainedRobot, j: int) -> Range | None:
    return interval("offset") or interval("reading_offset")


def _ratio(interval: Interval, robot: TrainedRobot, j: int) -> Range | None:
    return interval("ratio")


_JOINT: dict[str, dict[str, Callable[[Interval, TrainedRobot, int], Range | None]]] = {
    "stiffness_gain": {"kp": _ratio},
    "damping_gain": {"kd": _ratio},
    # A weak motor gives a share of the whole servo torque.
    "motor_gain": {"kp": _ratio, "kd": _ratio},
    "armature": {"armature": _armature},
    "coulomb_friction": {"joint_friction": lambda interval, robot, j: interval("friction")},
    "joint_offset": {"encoder": _offset},
}

_NOT_SIMULATED = {"motor_gain": ("force limit",)}
"""Effect -> what it changes on the robot beside what is taken from it."""


def _com(interval: Interval) -> dict[str, Any]:
    return {"com": _axes(interval, "x", "y", "z")}


def _gyro(interval: Interval) -> dict[str, Any]:
    return {"gyro": _axes(interval, "gyro_x", "gyro_y", "gyro_z")}


def _axes(interval: Interval, *names: str) -> tuple[Range, ...] | None:
    """The three intervals, nothing where one is absent; None where all are: the cause says nothing about them."""
    found = [interval(name) for name in names]
    return tuple(bounds or (0.0, 0.0) for bounds in found) if any(found) else None


def _sigma(interval: Interval) -> dict[str, Any]:
    bounds = interval("sigma")
    return {"depth_noise": None if bounds is None else sum(bounds) / 2}


_WHOLE: dict[str, Callable[[Interval], dict[str, Any]]] = {
    "command_delay": lambda interval: {"delay": interval("delay")},
    "camera_delay": lambda interval: {"depth_latency": interval("delay")},
    # The nominal sliding friction of both robots' models is 1, so that a ratio on it is the coefficient itself.
    "ground_friction": lambda interval: {"friction": interval("ratio")},
    "payload": lambda interval: {"payload": interval("mass")},
    "com_offset": _com,
    "terrain_scale": lambda interval: {"terrain_scale": interval("ratio")},
    "imu_bias": _gyro,
    "depth_noise": _sigma,
}
