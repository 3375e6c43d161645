"""Everything that the true robot may do otherwise than its model, as plain numbers a joint or a body."""

from dataclasses import dataclass, field

import numpy as np


@dataclass
class Truth:
    """The true robot's deviations. Arrays are (J,), in the order of the robot's joints; neutral by default."""

    joints: int
    kp: np.ndarray = field(init=False)
    """Ratio on the drive's position gain."""
    kd: np.ndarray = field(init=False)
    """Ratio on the drive's velocity gain."""
    motor_gain: np.ndarray = field(init=False)
    """Ratio of the torque delivered to the torque requested."""
    torque_limit: np.ndarray = field(init=False)
    """N m, infinite where the model's own limit holds."""
    no_load_speed: np.ndarray = field(init=False)
    """rad/s at which the drive's torque has fallen to zero; infinite: no such limit."""
    coulomb: np.ndarray = field(init=False)
    """N m beyond the model's own."""
    viscous: np.ndarray = field(init=False)
    """N m s/rad beyond the model's own."""
    stribeck: np.ndarray = field(init=False)
    """N m by which breaking loose exceeds sliding."""
    load_friction: np.ndarray = field(init=False)
    """Friction as a share of the transmitted torque."""
    armature: np.ndarray = field(init=False)
    """kg m^2 beyond the model's own."""
    backlash: np.ndarray = field(init=False)
    """rad of play between motor and link."""
    compliance: np.ndarray = field(init=False)
    """N m/rad between motor and link; infinite: rigid."""
    encoder_zero: np.ndarray = field(init=False)
    """rad that the encoder reads too much; the drive believes it."""
    stribeck_speed: float = 0.1
    """rad/s, width of the dip in friction."""
    command_delay: float = 0.0
    observation_delay: float = 0.0
    gyro_bias: np.ndarray = field(default_factory=lambda: np.zeros(3))
    acc_bias: np.ndarray = field(default_factory=lambda: np.zeros(3))
    # Edits of bodies: name -> value.
    payload: dict[str, tuple[float, np.ndarray]] = field(default_factory=dict)
    mass_ratio: dict[str, float] = field(default_factory=dict)
    inertia_ratio: dict[str, float] = field(default_factory=dict)
    com: dict[str, np.ndarray] = field(default_factory=dict)
    lengthen: dict[str, float] = field(default_factory=dict)
    """m by which the next body (or the foot) hangs farther out."""
    force: dict[str, tuple[np.ndarray, float, float]] = field(default_factory=dict)
    """body -> (N in the world, from s, to s) in every run."""
    # The ground.
    friction_ratio: float = 1.0
    contact_time: float = 0.0
    """s added to the contact's time constant."""
    raised: dict[str, float] = field(default_factory=dict)
    scale: float = 1.0
    """Ratio on all sizes and places of the supports."""
    tilt: np.ndarray = field(default_factory=lambda: np.zeros(2))
    wobble: dict[str, tuple[float, float]] = field(default_factory=dict)
    """support -> (N/m, N s/m) of a vertical spring under it."""
    # Outside every library: extra torque on the joints from (time, q, v, asked torque).
    strange: list = field(default_factory=list)
    dropout: tuple[int, float, float] | None = None
    """(joint, period s, length s) in which the drive goes limp."""
    encoder_ripple: tuple[int, float, int] | None = None
    """(joint, amplitude rad, periods a turn)."""

    def __post_init__(self) -> None:
        n = self.joints
        for name in ("kp", "kd", "motor_gain"):
            setattr(self, name, np.ones(n))
        for name in ("torque_limit", "no_load_speed", "compliance"):
            setattr(self, name, np.full(n, np.inf))
        for name in ("coulomb", "viscous", "stribeck", "load_friction", "armature", "backlash", "encoder_zero"):
            setattr(self, name, np.zeros(n))
