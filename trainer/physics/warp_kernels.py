"""What the GPU engine adds to MuJoCo Warp's own kernels. None of them allocates or waits: a CUDA graph holds them."""

from __future__ import annotations

import warp as wp
from mujoco_warp import OverflowType

GROUND, TERRAIN, LIMB = -3, -2, -1
"""Kinds of geoms; a foot's geoms have the foot's index, 0 or more."""

_GROUND, _TERRAIN, _LIMB = wp.constant(GROUND), wp.constant(TERRAIN), wp.constant(LIMB)

LIMITS = int(OverflowType.ITERATIONS | OverflowType.LS_ITERATIONS)
"""Bits of `data.overflow` that say that the solver stopped at its limit: a step that is less exact, nothing lost."""
_LIMITS = wp.constant(LIMITS)


@wp.kernel
def choose_targets(
    step: int,
    delay: wp.array(dtype=int),
    previous: wp.array2d(dtype=float),
    wanted: wp.array2d(dtype=float),
    ctrl: wp.array2d(dtype=float),
):
    """A world with delay d still holds its previous targets in the physics steps before the d-th."""
    world, joint = wp.tid()
    if step < delay[world]:
        ctrl[world, joint] = previous[world, joint]
    else:
        ctrl[world, joint] = wanted[world, joint]


@wp.kernel
def clear_contacts(ground: wp.array(dtype=wp.bool), other: wp.array(dtype=wp.bool), forces: wp.array2d(dtype=wp.vec3)):
    """At the start of a policy step."""
    world = wp.tid()
    ground[world] = False
    other[world] = False
    for foot in range(forces.shape[1]):
        forces[world, foot] = wp.vec3(0.0)


@wp.kernel
def watch_contacts(
    found: wp.array(dtype=int),
    geoms: wp.array(dtype=wp.vec2i),
    worlds: wp.array(dtype=int),
    distance: wp.array(dtype=float),
    margin: wp.array(dtype=float),
    kind: wp.array(dtype=int),
    ground: wp.array(dtype=wp.bool),
    other: wp.array(dtype=wp.bool),
):
    """Who touches what, one thread a contact. Threads of a world write the same value: no order matters."""
    contact = wp.tid()
    if contact >= found[0] or distance[contact] >= margin[contact]:
        return
    world = worlds[contact]
    a = kind[geoms[contact][0]]
    b = kind[geoms[contact][1]]
    if a == _GROUND or b == _GROUND:
        ground[world] = True
    if a == _LIMB or b == _LIMB:
        other[world] = True


@wp.kernel
def sum_foot_forces(
    found: wp.array(dtype=int),
    geoms: wp.array(dtype=wp.vec2i),
    worlds: wp.array(dtype=int),
    frame: wp.array(dtype=wp.mat33),
    friction: wp.array(dtype=wp.types.vector(length=5, dtype=float)),
    dim: wp.array(dtype=int),
    address: wp.array2d(dtype=int),
    efc_force: wp.array2d(dtype=float),
    rows: int,
    kind: wp.array(dtype=int),
    forces: wp.array2d(dtype=wp.vec3),
):
    """Net contact force on every foot, world axes, from the pyramid's edges: each pushes along normal +- mu tangent."""
    contact = wp.tid()
    if contact >= found[0]:
        return
    world = worlds[contact]
    a = kind[geoms[contact][0]]
    b = kind[geoms[contact][1]]
    start = address[contact, 0]
    if (a < 0 and b < 0) or start < 0:
        return
    local = wp.vec3(0.0)
    if dim[contact] == 1:
        local[0] = efc_force[world, start]
    else:
        for i in range(2):
            if start + 2 * i + 1 < rows:
                plus = efc_force[world, start + 2 * i]
                minus = efc_force[world, start + 2 * i + 1]
                local[0] += plus + minus
                local[i + 1] = (plus - minus) * friction[contact][i]
    force = wp.transpose(frame[contact]) * local  # rows of the frame: normal from geom 0 to geom 1, two tangents
    if a >= 0:
        wp.atomic_sub(forces, world, a, force)
    if b >= 0:
        wp.atomic_add(forces, world, b, force)


@wp.kernel
def guard(
    max_speed: float,
    policy_dt: float,
    wanted: wp.array2d(dtype=float),
    qpos: wp.array2d(dtype=float),
    qvel: wp.array2d(dtype=float),
    warmstart: wp.array2d(dtype=float),
    overflow: wp.array(dtype=int),
    sound_qpos: wp.array2d(dtype=float),
    sound_qvel: wp.array2d(dtype=float),
    previous: wp.array2d(dtype=float),
    joint_acc: wp.array2d(dtype=float),
    torque: wp.array2d(dtype=float),
    forces: wp.array2d(dtype=wp.vec3),
    diverged: wp.array(dtype=wp.bool),
    overflowed: wp.array(dtype=int),  # (2,): worlds with something lost, worlds whose solver stopped at its limit
):
    """Put worlds that diverged back to their last sound state, keep the others' as sound; one thread a world."""
    world = wp.tid()
    wrong = wp.int32(0)
    for i in range(qpos.shape[1]):
        if not wp.isfinite(qpos[world, i]):
            wrong += 1
    for i in range(qvel.shape[1]):
        limit = max_speed
        if i >= 3:
            limit = 10.0 * max_speed
        if not (wp.abs(qvel[world, i]) < limit):  # false for a NaN too
            wrong += 1
    for i in range(wanted.shape[1]):
        if not wp.isfinite(wanted[world, i]):
            wrong += 1

    diverged[world] = wrong > 0
    if wrong > 0:
        for i in range(joint_acc.shape[1]):
            joint_acc[world, i] = 0.0
            torque[world, i] = 0.0
        for foot in range(forces.shape[1]):
            forces[world, foot] = wp.vec3(0.0)
        for i in range(qpos.shape[1]):
            qpos[world, i] = sound_qpos[world, i]
        for i in range(qvel.shape[1]):
            qvel[world, i] = sound_qvel[world, i]
            warmstart[world, i] = 0.0
    else:
        for i in range(joint_acc.shape[1]):
            joint_acc[world, i] = (qvel[world, 6 + i] - sound_qvel[world, 6 + i]) / policy_dt
            previous[world, i] = wanted[world, i]
        for i in range(qpos.shape[1]):
            sound_qpos[world, i] = qpos[world, i]
        for i in range(qvel.shape[1]):
            sound_qvel[world, i] = qvel[world, i]
    if overflow[world] != 0:
        if (overflow[world] & ~_LIMITS) != 0:
            wp.atomic_add(overflowed, 0, 1)
        if (overflow[world] & _LIMITS) != 0:
            wp.atomic_add(overflowed, 1, 1)
        overflow[world] = 0


@wp.kernel
def write_feet(
    bodies: wp.array(dtype=int),
    joints: wp.array2d(dtype=int),  # of each foot, hinges from base to foot, filled up with -1; MuJoCo's joint numbers
    qvel: wp.array2d(dtype=float),
    xpos: wp.array2d(dtype=wp.vec3),
    xquat: wp.array2d(dtype=wp.quat),
    xmat: wp.array2d(dtype=wp.mat33),
    xanchor: wp.array2d(dtype=wp.vec3),
    xaxis: wp.array2d(dtype=wp.vec3),
    base: int,
    forces: wp.array2d(dtype=wp.vec3),
    pos: wp.array2d(dtype=wp.vec3),
    quat: wp.array2d(dtype=wp.quat),
    lin_vel: wp.array2d(dtype=wp.vec3),
    ang_vel: wp.array2d(dtype=wp.vec3),
    force: wp.array2d(dtype=float),
):
    """Pose and velocity of every foot: the base's motion plus that of each hinge on the way down."""
    world, foot = wp.tid()
    body = bodies[foot]
    at = xpos[world, body]
    linear = wp.vec3(qvel[world, 0], qvel[world, 1], qvel[world, 2])
    angular = xmat[world, base] * wp.vec3(qvel[world, 3], qvel[world, 4], qvel[world, 5])
    linear += wp.cross(angular, at - xpos[world, base])
    for k in range(joints.shape[1]):
        joint = joints[foot, k]
        if joint >= 0:
            spin = xaxis[world, joint] * qvel[world, 5 + joint]  # joint 0 is the base's free one: 6 of velocity
            angular += spin
            linear += wp.cross(spin, at - xanchor[world, joint])
    pos[world, foot] = at
    quat[world, foot] = xquat[world, body]
    lin_vel[world, foot] = linear
    ang_vel[world, foot] = angular
    force[world, foot] = wp.length(forces[world, foot])
