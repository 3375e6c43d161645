"""The IMU reads a constant too much."""

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import EXACT, Edit, Effect, Excitation, Law, Parameter, Place, Where, Words


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    gyro = [Parameter(f"gyro_{a}", "rad/s", (-1.0, 1.0), 0.05, nuisance=0.004) for a in "xyz"]
    acc = [Parameter(f"acc_{a}", "m/s^2", (-5.0, 5.0), 0.5, nuisance=0.04) for a in "xyz"]
    return (*gyro, *acc)


def _excited(context: Context, place: Place) -> Excitation:
    return Excitation(context.case.has_imu, "an IMU is logged")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    signals = edit.signals
    x, y, z = signals.gyro_bias
    signals.gyro_bias = (x + values["gyro_x"], y + values["gyro_y"], z + values["gyro_z"])
    x, y, z = signals.acc_bias
    signals.acc_bias = (x + values["acc_x"], y + values["acc_y"], z + values["acc_z"])


IMU_BIAS = Effect(
    name="imu_bias",
    where=Where("global", lambda context: [()] if context.case.has_imu else []),
    parameters=_parameters,
    apply=_apply,
    words=Words(
        settings=("noise and bias of base_ang_vel", "noise and bias of base_ang_vel", "calibrate the IMU at rest"),
        title="IMU bias",
        description="Constant offsets on the gyroscope and accelerometer.",
        signature="A constant in the IMU only; joints and base are right.",
        excitation=("an IMU and any motion",),
        changed_by="temperature of the IMU",
        sort="direction",
    ),
    excited_by=_excited,
    variants=(("gyro_x", "gyro_y", "gyro_z"), ("acc_x", "acc_y", "acc_z")),
    patchable=False,
    law=Law(form=EXACT),
)
