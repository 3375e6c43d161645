"""Joints that no drive of their own moves rub, too: a pole on a cart, fingers that a tendon moves."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.diagnosis.strangers import CARTPOLE, GRIPPER
from realsim.gap import Case, DiagnoseConfig, diagnose, load_case
from realsim.gap.simulation.simulate import Simulator
from tests.gap.searching import CONFIG, fitting, logged

TIME = np.arange(0.0, 4.0, 0.01)
EFFECTS = ("viscous_friction", "coulomb_friction", "payload")


def case_of(folder: Path, xml: str, joints: list[str], actuator: str, kind: str, commands: list[np.ndarray]) -> Case:
    """A case whose log is the simulator's own."""
    (folder / "runs").mkdir(parents=True)
    (folder / "model.xml").write_text(xml)
    log = {"joint_names": joints, "actuator_names": [actuator], "command_kind": kind, "base": "fixed"}
    (folder / "log.json").write_text(json.dumps(log))
    for k, command in enumerate(commands):
        place = np.repeat(np.sin(TIME)[:, None], len(joints), axis=1)  # takes its values from the simulator below
        np.savez(folder / "runs" / f"{k}.npz", time=TIME, command=command[:, None], joint_pos=place)
    return logged(load_case(folder), [])


@pytest.fixture
def cart(tmp_path: Path) -> Case:
    pushes = [8 * np.sin(2 * np.pi * f * TIME) * np.clip(TIME - 0.3, 0, 1) for f in (0.7, 1.1, 1.6)]
    return case_of(tmp_path / "cart", CARTPOLE, ["rail", "pin"], "belt", "torque", pushes)


def test_friction_in_a_pin_is_found(cart: Case) -> None:
    case = logged(cart, [("viscous_friction", ("pin",), {"damping": 0.02})])
    found = diagnose(case, DiagnoseConfig(threads=1, effects=EFFECTS, report=False))
    (cause,) = found.causes
    assert (cause["effect"], cause["joints"]) == ("viscous_friction", ["pin"])
    assert cause["parameters"]["damping"]["value"] == pytest.approx(0.02, rel=0.1)


def test_no_value_is_shared_by_a_joint_that_turns_and_one_that_slides(cart: Case) -> None:
    with fitting(cart, EFFECTS) as fitter:
        frictions = [c for c in fitter.screen.candidates if c.effect == "coulomb_friction"]
        assert {c.place for c in frictions} == {("rail",), ("pin",)}
        units = {c.place: c.parameters[0].unit for c in frictions}
    assert units == {("rail",): "N", ("pin",): "N m"}


def test_a_tendon_loads_the_joints_that_it_moves(tmp_path: Path) -> None:
    opens = [0.02 + 0.012 * np.sin(2 * np.pi * f * TIME) for f in (0.4, 0.9)]
    case = case_of(tmp_path / "hand", GRIPPER, ["left_slide", "right_slide"], "grip", "position", opens)
    with Simulator(case, CONFIG) as simulator:
        context = simulator.context
        assert context.passive == ["left_slide", "right_slide"]
        assert all(0.3 < context.peak_torque[j] < 16 for j in context.passive)  # N; the drive gives 30 on both
