"""What a diagnosis knows replaces what the randomisation guesses; what it cannot say is not dropped silently."""

import json
import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from realsim.core.geometry import quat_to_R
from tests.trainer.fakes import BoxCaster, FakePhysics, course, quadruped
from tests.trainer.task_env import QUIET, env_of, still
from trainer.errors import TrainerError
from trainer.physics import PhysicsConfig
from trainer.robots import ROBOTS
from trainer.tasks.parkour import ParkourConfig, ParkourEnv, make
from trainer.tasks.parkour.build import with_known
from trainer.tasks.parkour.config import DepthConfig, RandomisationConfig
from trainer.tasks.parkour.gap import alone, load, patched
from trainer.tasks.parkour.randomise import Known, informed, limited, sizes
from trainer.terrain import generate
from trainer.terrain.changed import shifted


def cause(effect, joints=None, bodies=None, **parameters):
    entry = {"effect": effect, "parameters": {k: {"value": sum(v) / 2, "ci90": list(v)} for k, v in parameters.items()}}
    return entry | ({"joints": joints} if joints else {}) | ({"bodies": bodies} if bodies else {})


@pytest.fixture
def diagnosis(tmp_path):
    def write(*causes, verdict="identified", equivalent=(), patch=None):
        path = tmp_path / "diagnosis.json"
        data = {"verdict": verdict, "causes": list(causes), "equivalent": list(equivalent), "patch": patch}
        path.write_text(json.dumps(data))
        return path

    return write


def test_causes_become_ranges(diagnosis):
    robot = ROBOTS["g1"]()
    knee = robot.joints.index("left_knee_joint")
    own = float(robot.robot.spec.joint("left_knee_joint").armature)
    known = load(
        diagnosis(
            cause("motor_gain", ["left_knee_joint"], ratio=(0.8, 0.9)),
            cause("stiffness_gain", ["left_knee_joint"], ratio=(0.5, 0.5)),
            cause("armature", ["left_knee_joint"], armature=(own, 2 * own)),
            cause("coulomb_friction", ["left_knee_joint"], friction=(1.0, 2.0)),
            cause("joint_offset", ["left_knee_joint"], offset=(0.05, 0.07)),
            cause("command_delay", delay=(0.010, 0.012)),
            cause("payload", bodies=["torso_link"], mass=(1.5, 1.7), x=(0.0, 0.0)),
            cause("terrain_scale", ratio=(1.02, 1.04)),
            cause("backlash", ["left_knee_joint"], gap=(0.01, 0.02)),
        ),
        robot,
    )
    assert known.kp == {knee: pytest.approx((0.4, 0.45))}
    assert known.kd == {knee: (0.8, 0.9)}
    assert known.armature == {knee: pytest.approx((2.0, 3.0))}
    assert known.joint_friction == {knee: (1.0, 2.0)}
    assert known.encoder == {knee: (0.05, 0.07)}
    assert known.delay == (0.010, 0.012)
    assert known.payload == (1.5, 1.7)
    assert known.unused == ("motor_gain (force limit)", "payload (x)", "backlash")
    assert sizes([course()], informed(RandomisationConfig(), known)) == pytest.approx([1.02, 1.025, 1.03, 1.035, 1.04])


def test_an_effect_without_joints_acts_on_all_of_them(diagnosis):
    known = load(diagnosis(cause("damping_gain", ratio=(1.1, 1.2))), quadruped())
    assert known.kd == dict.fromkeys(range(12), (1.1, 1.2))


def test_an_unexplained_gap_changes_nothing_and_says_so(diagnosis):
    known = load(diagnosis(cause("command_delay", delay=(0.01, 0.02)), verdict="unexplained"), quadruped())
    assert known.delay is None
    assert known.unused == ("command_delay (unexplained)",)


def test_a_partly_explained_gap_is_taken_as_far_as_it_goes(diagnosis):
    path = diagnosis(cause("command_delay", delay=(0.01, 0.02)), verdict="partly_explained")
    assert load(path.parent, quadruped()).delay == (0.01, 0.02)


def test_each_world_draws_one_of_the_sets_that_explain_the_same(diagnosis):
    robot = quadruped()
    joint = robot.joints[2]
    shared = cause("command_delay", delay=(0.01, 0.01))
    weak = [shared, cause("stiffness_gain", [joint], ratio=(0.5, 0.6))]
    stuck = [shared, cause("coulomb_friction", [joint], friction=(1.0, 2.0))]
    known = load(diagnosis(*weak, verdict="ambiguous", equivalent=[stuck]), robot)
    env = env_of(replace(QUIET, randomisation=RandomisationConfig(push=0.0)), worlds=200, known=known)
    env.reset()
    _, params = env.physics.params[-1]
    gain, friction = params.kp_scale[:, 2], params.joint_friction[:, 2]
    weak_ones = gain < 0.65
    assert 60 < int(weak_ones.sum()) < 140
    assert ((friction >= 1.0) == ~weak_ones).all()
    assert set(params.delay_steps.tolist()) == {2}


def patch_of(robot, *settings):
    joints = dict.fromkeys(robot.joints, 30.0)
    scales = dict.fromkeys(("peak_torque", "speed", "mean_torque", "mean_speed", "torque_range", "inertia"), joints)
    return {
        "format": "realsim.gap.patch/2",
        "settings": [{"effect": e, "place": list(p), "coordinates": c} for e, p, c in settings],
        "scales": scales,
    }


def test_what_no_range_can_hold_goes_into_the_model(diagnosis):
    robot = quadruped()
    knee, everywhere = robot.joints[2], tuple(robot.joints)
    at = {"x": -0.1, "y": 0.05, "z": 0.1}
    load_on_trunk = cause("payload", bodies=["trunk"], mass=(1.8, 2.2), x=(-0.1, -0.1), y=(0.05, 0.05), z=(0.1, 0.1))
    causes = [
        load_on_trunk,
        cause("motor_gain", [knee], ratio=(0.45, 0.55)),
        cause("backlash", [knee], gap=(0.01, 0.02)),
    ]
    settings = [
        ("payload", ("trunk",), {"mass": 2.0, **at}),
        ("motor_gain", (knee,), {"ratio": math.log(0.5)}),
        ("backlash", (knee,), {"gap": 0.015}),
    ]
    known = load(diagnosis(*causes, patch=patch_of(robot, *settings)), robot)
    assert known.unused == ("backlash",)  # it would add a joint
    assert known.payload == pytest.approx((-0.2, 0.2))
    assert known.kp == known.kd == {2: pytest.approx((0.9, 1.1))}
    before, after = (r.robot.spec.copy().compile() for r in (robot, patched(robot, known)))
    trunk = before.body("trunk").id
    assert after.body_mass[trunk] == pytest.approx(before.body_mass[trunk] + 2.0)
    moved = (before.body_mass[trunk] * before.body_ipos[trunk] + 2.0 * np.array([*at.values()])) / after.body_mass[
        trunk
    ]
    assert after.body_ipos[trunk] == pytest.approx(moved, abs=1e-9)
    assert after.actuator_forcerange[2] == pytest.approx(0.5 * before.actuator_forcerange[2])
    assert after.actuator_forcerange[1] == pytest.approx(before.actuator_forcerange[1])
    assert len(everywhere) == after.nu == before.nu


def test_only_what_all_sets_share_goes_into_the_model(diagnosis):
    robot = quadruped()
    weak = cause("motor_gain", [robot.joints[2]], ratio=(0.5, 0.5))
    patch = patch_of(robot, ("motor_gain", (robot.joints[2],), {"ratio": math.log(0.5)}))
    known = load(diagnosis(weak, verdict="ambiguous", equivalent=[[cause("command_delay", delay=(0.02, 0.03))]],
                           patch=patch), robot)  # fmt: skip
    assert known.model is None
    assert known.alternatives[0].kp == {2: (0.5, 0.5)}
    assert known.alternatives[1].kp == {}


def test_commands_are_late_by_more_than_a_policy_step(diagnosis):
    known = load(diagnosis(cause("command_delay", delay=(0.05, 0.05))), quadruped())
    env = env_of(replace(QUIET, randomisation=RandomisationConfig(push=0.0)), known=known)
    env.reset()
    assert set(env.physics.params[-1][1].delay_steps.tolist()) == {2}  # 50 ms: two policy steps wait, 10 ms the engine
    told = []
    for action in (1.0, 2.0, 3.0):
        env.step(torch.full_like(still(env), action))
        told.append(env.physics.targets.clone())
    default, scale = torch.tensor(env.physics.robot.default).float(), float(env.body.action_scale[0])
    assert torch.allclose(told[0], env.physics.state.joint_pos)  # nothing has arrived: the pose of the start is held
    assert torch.allclose(told[1], told[0])
    assert torch.allclose(told[2], (default + scale).expand_as(told[2]))


def test_the_camera_is_as_diagnosed(diagnosis):
    known = load(
        diagnosis(cause("camera_delay", delay=(0.05, 0.07)), cause("depth_noise", ratio=(2.0, 4.0))), quadruped()
    )
    depth = with_known(ParkourConfig(), known, PhysicsConfig()).depth
    assert depth.latency == (2, 4)
    assert depth.noise == pytest.approx(0.03)


def test_the_camera_stands_where_it_was_found_whatever_the_motion_says(diagnosis):
    robot = ROBOTS["g1"]()
    turns = {"turn_x": (0.08, 0.12), "turn_y": (0.0, 0.0), "turn_z": (0.0, 0.0)}
    shifts = {"shift_x": (0.02, 0.02), "shift_y": (0.0, 0.0), "shift_z": (0.028, 0.032)}
    causes = [cause("command_delay", delay=(0.01, 0.02)), cause("camera_mount", **turns, **shifts)]
    known = load(diagnosis(*causes, verdict="unexplained"), robot)
    assert known.unused == ("command_delay (unexplained)",)
    before, after = robot.camera, patched(robot, known).camera
    R = quat_to_R(before.quat)
    assert after.pos - before.pos == pytest.approx(R @ [0.03, -0.02, 0.0])  # forward, and to the right
    # About the axis to the right by 0.1 rad, which lifts the view.
    assert R.T @ quat_to_R(after.quat) @ [1, 0, 0] == pytest.approx([math.cos(0.1), 0.0, math.sin(0.1)])
    depth = with_known(ParkourConfig(), known, PhysicsConfig()).depth
    assert (depth.mount_rotation, depth.mount_position) == pytest.approx((0.02, 0.002))


def test_worlds_are_drawn_from_what_is_known(diagnosis):
    robot = quadruped()
    joint = robot.joints[2]
    known = load(
        diagnosis(cause("motor_gain", [joint], ratio=(0.70, 0.72)), cause("command_delay", delay=(0.01, 0.01))), robot
    )
    physics = FakePhysics(robot, [course()], 50)
    edges = [torch.zeros(0, 2, 3).numpy()]
    env = ParkourEnv(physics, BoxCaster([course()]), edges, ParkourConfig(depth=DepthConfig(use=False)), known=known)
    env.reset()
    _, params = physics.params[-1]
    assert params.kp_scale[:, 2].min() >= 0.70
    assert params.kp_scale[:, 2].max() <= 0.72
    assert params.kp_scale[:, 3].max() > 1.0
    assert set(params.delay_steps.tolist()) == {2}


def test_what_is_taken_in_part_is_named(diagnosis):
    causes = [
        cause("imu_bias", acc_x=(0.1, 0.2), acc_y=(0.0, 0.0), acc_z=(0.0, 0.0)),
        cause("command_delay", delay=(-0.02, 0.04)),
    ]
    known = load(diagnosis(*causes), quadruped())
    assert known.gyro is None  # the guessed range stays
    assert known.unused == ("imu_bias (acc_x, acc_y, acc_z)",)
    env = env_of(known=known)
    assert [text.split(":")[0] for text in env.warnings] == [*known.unused, "command_delay (outside 0 to 200 ms)"]
    assert limited(Known(delay=(0.01, 0.201)), PhysicsConfig()).unused == ()
    gyro = load(diagnosis(cause("imu_bias", gyro_x=(0.1, 0.2))), quadruped())
    assert (gyro.gyro, gyro.unused) == (((0.1, 0.2), (0.0, 0.0), (0.0, 0.0)), ())


@pytest.mark.parametrize(("parameter", "shift"), [("offset", 0.1), ("reading_offset", 0.0)])
def test_a_servo_that_reads_the_offset_stands_elsewhere(diagnosis, parameter, shift):
    robot = quadruped()
    known = load(diagnosis(cause("joint_offset", [robot.joints[4]], **{parameter: (0.1, 0.1)})), robot)
    assert known.unused == ()
    env = env_of(replace(QUIET, randomisation=RandomisationConfig(push=0.0)), known=known)
    env.reset()
    env.step(still(env))
    told = torch.tensor(robot.default).float().repeat(4, 1)
    told[:, 4] -= shift
    assert torch.allclose(env.physics.targets, told)
    assert torch.allclose(env.proprioception.encoder_offset[:, 4], torch.tensor(0.1))


def test_another_robots_diagnosis_is_refused(diagnosis):
    with pytest.raises(TrainerError, match="another robot"):
        load(diagnosis(cause("motor_gain", ["left_knee_joint"], ratio=(0.8, 0.9))), quadruped())


@pytest.mark.parametrize("ends", [(0.005, -1.0), (0.0, float("inf"))])
def test_an_interval_that_is_none_is_refused(ends, diagnosis):
    with pytest.raises(TrainerError, match="upside down or not finite"):
        load(diagnosis(cause("command_delay", delay=ends)), quadruped())


@pytest.mark.parametrize("text", ["[]", "{}", '{"causes": 3, "verdict": "identified"}'])
def test_what_is_no_diagnosis_is_refused(text, tmp_path):
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(TrainerError, match="not a diagnosis"):
        load(path, quadruped())


def test_ground_that_gives_and_is_higher_reaches_the_training(diagnosis):
    """As randomisation of contacts, and as terrain whose pieces stand elsewhere; names that are not there are said."""
    path = diagnosis(
        cause("contact_compliance", time_constant=(0.03, 0.05)),
        cause("terrain_height", bodies=["slot1"], height=(0.018, 0.022)),
        cause("terrain_wobble", bodies=["slot1"], stiffness=(1e4, 2e4)),
        cause("terrain_height", bodies=["stake_L4"], height=(0.01, 0.01)),
    )
    land = generate("boxes", 0.3, 0)
    env = make(ParkourConfig(), [land], robot="quadruped", worlds=2, diagnosis=path, physics=PhysicsConfig(threads=1))
    env.reset()
    times = [float(env.physics._model(w).geom_solref[env.physics._model(w).geom("slot1").id, 0]) for w in range(2)]
    assert all(0.05 <= t <= 0.07 for t in times)
    raised = env.physics.terrains[2]  # five sizes, the third is the true one
    assert raised.boxes[1].T[2, 3] - land.boxes[1].T[2, 3] == pytest.approx(0.02)
    assert raised.boxes[0].T[2, 3] == pytest.approx(land.boxes[0].T[2, 3])
    np.testing.assert_allclose(raised.vertices[8:16, 2] - land.vertices[8:16, 2], 0.02)
    assert env.randomiser.known.unused == ("terrain_wobble", "terrain_height (no stake_L4 here)")


def test_each_cause_alone_is_a_diagnosis(diagnosis):
    settings = [{"effect": e, "place": [], "coordinates": {}} for e in ("command_delay", "payload")]
    path = diagnosis(
        cause("command_delay", delay=(0.01, 0.012)), cause("payload", mass=(1.0, 1.2)), patch={"settings": settings}
    )
    found = alone(path)
    assert list(found) == ["command_delay", "payload"]
    path.write_text(json.dumps(found["payload"]))
    known = load(path, quadruped())
    assert known.payload == (1.0, 1.2)
    assert known.delay is None
    assert found["payload"]["patch"]["settings"] == settings[1:]


def test_a_moved_piece_of_a_scene_is_seen_and_felt():
    contact = mujoco.MjSpec()
    contact.worldbody.add_geom(name="stake", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.1], pos=[1, 0, -0.1])
    land = replace(course(), contact=contact, boxes=(), vertices=np.array([[1.0, 0, 0], [1.05, 0.05, 0], [2.0, 0, 0]]))
    (moved,), missing = shifted([land], {"stake": (-0.03, -0.01), "other": (0.1, 0.1)})
    assert missing == ("other",)
    assert moved.contact.geom("stake").pos[2] == pytest.approx(-0.12)
    np.testing.assert_allclose(moved.vertices[:, 2], [-0.02, -0.02, 0.0])
    assert land.contact.geom("stake").pos[2] == pytest.approx(-0.1)
