"""A case of the contract as a test writes it."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np


def write_case(folder: Path, xml: str, runs: Mapping[str, Mapping[str, Any]], **log: Any) -> Path:
    """model.xml, log.json and runs/NAME.npz. Where `log` is silent: all joints and actuators of the model, position
    targets, and a base that floats where a joint is free."""
    model = mujoco.MjModel.from_xml_string(xml)
    moving = np.flatnonzero(model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE))
    facts = {
        "joint_names": [model.joint(int(i)).name for i in moving],
        "actuator_names": [model.actuator(i).name for i in range(model.nu)],
        "command_kind": "position",
        "base": "floating" if (model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)).any() else "fixed",
        "torque_kind": "none",
        "imu_site": None,
    }
    (folder / "runs").mkdir(parents=True, exist_ok=True)
    (folder / "model.xml").write_text(xml)
    (folder / "log.json").write_text(json.dumps(facts | log))
    for name, run in runs.items():
        np.savez_compressed(folder / "runs" / f"{name}.npz", **run)
    return folder
