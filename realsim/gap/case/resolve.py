"""A model's spec with what MuJoCo's compiler works out anew each time written down, so that edits do what they say."""

from typing import Any

import numpy as np

from realsim.core.types import MjSpec

INFER, AUTO = 1, 2
"""mjINERTIAFROMGEOM_TRUE: a body's own inertial is ignored. mjINERTIAFROMGEOM_AUTO: it counts where there is one."""


def resolve(spec: MjSpec) -> None:
    """Write into a mujoco.MjSpec, in place, what else would undo an edit of it, or change with one.

    Servo gains that are a damping ratio, joint springs that are a time constant and inertials that the compiler
    changes become numbers; orientations given otherwise and fixed geoms given by their ends become pos and quat;
    static bodies are kept. The compiled model stays the same (but for bodies that were to be fused, whose sum it was).

    Raises:
        ValueError: if the spec does not compile.
    """
    spec.compiler.fusestatic = False  # else a body's compiled inertia holds that of bodies which are still there
    copy = spec.copy()
    model = copy.compile()
    for ours, theirs in zip(spec.actuators, copy.actuators, strict=True):
        if not np.array_equal(ours.biasprm, model.actuator_biasprm[theirs.id]):
            ours.biasprm = model.actuator_biasprm[theirs.id]
    for ours, theirs in zip(spec.joints, copy.joints, strict=True):
        if np.any(ours.springdamper):
            # Stiffness and damping of a joint that were given as a time constant and a damping ratio.
            stiffness, damping = np.zeros_like(ours.stiffness), np.zeros_like(ours.damping)
            stiffness[0], damping[0] = model.jnt_stiffness[theirs.id], model.dof_damping[model.jnt_dofadr[theirs.id]]
            ours.stiffness, ours.damping, ours.springdamper = stiffness, damping, np.zeros(2)
    changes_inertials = any(_changes_inertials(body.compiler) for body in spec.bodies)
    for ours, theirs in zip(spec.bodies, copy.bodies, strict=True):
        if theirs.id == 0:
            continue
        _write_orientation(spec, ours, "quat", ours.alt)
        if changes_inertials:
            ours.mass, ours.ipos = model.body_mass[theirs.id], model.body_ipos[theirs.id]
            ours.iquat, ours.inertia = model.body_iquat[theirs.id], model.body_inertia[theirs.id]
            ours.explicitinertial, ours.fullinertia = 1, [np.nan, 0, 0, 0, 0, 0]
            ours.ialt.type = type(ours.ialt.type).mjORIENTATION_QUAT
        elif ours.explicitinertial:
            _write_orientation(spec, ours, "iquat", ours.ialt)
    if changes_inertials:
        for body in spec.bodies:
            _leave_inertials(body.compiler)
    for ours, theirs in zip(spec.geoms, copy.geoms, strict=True):
        _write_orientation(spec, ours, "quat", ours.alt)
        fixed = model.body_weldid[model.geom_bodyid[theirs.id]] == 0
        if fixed and np.isfinite(ours.fromto).all() and ours.frame is None:
            ours.pos, ours.quat = model.geom_pos[theirs.id], model.geom_quat[theirs.id]
            ours.size, ours.fromto = model.geom_size[theirs.id], np.full(6, np.nan)


def _write_orientation(spec: MjSpec, part: Any, name: str, orientation: Any) -> None:
    """Euler angles, axes: they would win over a quaternion that an effect sets."""
    quat = type(orientation.type).mjORIENTATION_QUAT
    if orientation.type != quat:
        own = part.compiler
        setattr(part, name, spec.resolve_orientation(own.degree, own.eulerseq, orientation))
        orientation.type = quat


def _changes_inertials(own: Any) -> bool:
    bounds = own.settotalmass > 0 or own.boundmass > 0 or own.boundinertia > 0
    return int(own.inertiafromgeom) == INFER or bounds or bool(own.balanceinertia)


def _leave_inertials(own: Any) -> None:
    own.settotalmass, own.boundmass, own.boundinertia, own.balanceinertia = -1.0, 0.0, 0.0, False
    if int(own.inertiafromgeom) == INFER:
        own.inertiafromgeom = AUTO
