"""The body's own signals: orientation, accelerometer, gyroscope, place, feet."""

import numpy as np

from realsim.core.statistics import alike
from realsim.core.types import F64, Bool
from realsim.gap.case.units import ACCELERATION, TURNING, factor, gravity_unit, nearest_unit
from realsim.gap.recordings.evidence import Evidence
from realsim.gap.recordings.names import FEET
from realsim.gap.recordings.proposal import Candidate
from realsim.gap.recordings.signals import MOST, at, turning, upward
from realsim.gap.recordings.vocabulary import english

LIFTED = 0.15
"""Share of a standing foot's force below which a foot is in the air. Set by hand, tried on simulated feet only."""
APART = 0.2
"""Of the sum of two correlations, from which one order of a quaternion is preferred."""
ORDERS = {"wxyz": (0, 1, 2, 3), "xyzw": (3, 0, 1, 2)}
"""Where w, x, y, z stand in the columns."""


def orientation(e: Evidence) -> None:
    """The base's quaternion; its order is the one whose vertical agrees with the accelerometer."""
    source = _vector(e, "base_quat", 4)
    if source is None:
        return
    time, field = e.of(source)
    time, values = time[:MOST], field.values[:MOST]
    length = np.linalg.norm(values, axis=1)
    good = np.isfinite(length) & (length > 0.1)
    if good.mean() < 0.5 or abs(np.median(length[good]) - 1) > 0.1:
        e.warn(f"{source.label} is no quaternion: its length is {np.nanmedian(length):.3g}")
        return
    axes, evidence = ("w", "x", "y", "z"), [f"by {source.why}"]
    if set("wxyz") <= set(field.labels):
        e.settle("base_quat", source, [field.labels.index(a) for a in axes], axes, evidence, unit="as labelled")
        return
    declared = source.unit if source.unit in ORDERS else ""
    shown, scores = {}, {}
    for name, columns in ORDERS.items():
        quat = values[:, list(columns)]
        vertical, rates = _vertical(e, time, quat, good), _rates(e, time, quat, good)
        # The vertical alone does not tell a robot that stands upright from one turned about its vertical.
        scores[name] = vertical + rates
        shown[name] = f"{' '.join(name)} {vertical:.2f} and {rates:.2f}"
    apart = abs(scores["wxyz"] - scores["xyzw"])
    doubtful = not declared and apart < APART
    if doubtful:  # which of the two turns the robot less at its start
        order = max(ORDERS, key=lambda n: abs(float(values[good][0, ORDERS[n][0]])))
        evidence.append(f"its order cannot be tested: {' '.join(order)} turns the robot less at the start")
    else:
        order = max(scores, key=lambda n: scores[n]) if apart > APART else declared
        if apart > 0:
            agreement = "agreement of its vertical with the accelerometer and its turning with the gyro"
            evidence.append(f"{agreement}: {', '.join(shown.values())}")
    if declared and order != declared:
        e.warn(f"{source.label} is declared {declared}, and reads as {order}")
    e.settle("base_quat", source, ORDERS[order], axes, evidence, unit=order, doubtful=doubtful)


def _rates(e: Evidence, time: F64, quat: F64, good: Bool) -> float:
    """Mean correlation of an orientation's turning with the gyroscope, weighed by its axes; 0 without a gyroscope."""
    gyro = next((c for c in e.candidates if c.role == "imu_gyro" and e.of(c)[1].width >= 3), None)
    use = good.copy()
    use[1:] &= np.diff(time) > 0
    if gyro is None or use.sum() < 50:
        return 0.0
    t, field = e.of(gyro)
    clock, quat = time[use], quat[use]
    rate = turning(clock, quat / np.linalg.norm(quat, axis=1, keepdims=True))
    read = at(t, field.values[:, :3], 0.5 * (clock[1:] + clock[:-1]))
    size = np.nanstd(read, axis=0)
    return float(sum(s * alike(read[:, k], rate[:, k]) for k, s in enumerate(size)) / max(float(size.sum()), 1e-9))


def _vertical(e: Evidence, time: F64, quat: F64, good: Bool) -> float:
    """Median cosine of the accelerometer with the vertical of an orientation; 0 without an accelerometer."""
    acc = next((c for c in e.candidates if c.role == "imu_acc" and e.of(c)[1].width >= 3), None)
    if acc is None:
        return 0.0
    t, field = e.of(acc)
    force = at(t, field.values[:, :3], time)
    size = np.linalg.norm(force, axis=1)
    use = good & np.isfinite(size) & (size > 1e-6)
    if use.sum() < 5:
        return 0.0
    return float(np.median((upward(quat[use]) * force[use]).sum(axis=1) / size[use]))


def accelerometer(e: Evidence) -> None:
    """Specific force of an IMU: 9.81 upward at rest."""
    source = _vector(e, "imu_acc", 3)
    if source is None:
        return
    time, field = e.of(source)
    values = field.values[:MOST]
    size = float(np.nanmedian(np.linalg.norm(values, axis=1)))
    unit = gravity_unit(size)
    if not unit:
        why = "which is no gravity in any unit: has gravity been removed? Not used"
        e.warn(f"{source.label} is {size:.3g} long, {why}")
        return
    evidence, sign = [f"by {source.why}", f"{size:.3g} long in the median -> {unit}"], 1.0
    quat = e.beside("base_quat", time[:MOST])
    use = np.isfinite(values).all(axis=1)
    use = np.zeros_like(use) if quat is None else use & np.isfinite(quat).all(axis=1)
    if quat is not None and use.sum() > 5:
        along = float(np.median((upward(quat[use]) * values[use]).sum(axis=1)) / size)
        sign = -1.0 if along < -0.7 else 1.0
        evidence.append(f"along the vertical of the orientation: {along:.2f} of it")
        evidence += ["negated: an accelerometer at rest reads +g up"] if sign < 0 else []
    if _has_site(e, source):
        e.settle("imu_acc", source, range(3), tuple("xyz"), evidence, scale=sign * ACCELERATION[unit], unit=unit)


def gyroscope(e: Evidence) -> None:
    """Angular velocity of an IMU, by the orientation's change."""
    source = _vector(e, "imu_gyro", 3)
    if source is None or not _has_site(e, source):
        return
    time, field = e.of(source)
    values = field.values[:MOST]
    evidence, unit, sign = [f"by {source.why}"], source.unit or "rad/s", 1.0
    found = e.series("base_quat")
    if found is not None and len(found[0]) > 50:
        t, quat = found[0][:MOST], found[1][:MOST]
        keep = np.isfinite(quat).all(axis=1) & (np.linalg.norm(quat, axis=1) > 0.5)
        keep[1:] &= np.diff(t) > 0
        t, rate = t[keep], turning(t[keep], quat[keep])
        read = at(time[:MOST], values, 0.5 * (t[1:] + t[:-1]))
        axis = int(np.nanargmax(np.nanstd(rate, axis=0)))
        corr = alike(read[:, axis], rate[:, axis])
        if abs(corr) > 0.5:
            ratio = factor(read[:, axis], rate[:, axis])
            unit, sign = nearest_unit(ratio, TURNING), float(np.sign(ratio))
            text = f"against the orientation's change: correlation {corr:.2f}, factor {ratio:.3g} -> {unit}"
            evidence.append(text + (", negated" if sign < 0 else ""))
    scale = TURNING.get(unit, 1.0)
    largest = float(np.nanmax(np.abs(values))) * scale
    if largest > 60:
        evidence.append(f"up to {largest:.3g} rad/s, which is much: is it in deg/s?")
    doubtful = len(evidence) < 2
    e.settle("imu_gyro", source, range(3), tuple("xyz"), evidence, scale=sign * scale, unit=unit, doubtful=doubtful)


def place(e: Evidence) -> None:
    """The base's position, for a robot that can move."""
    if e.target is not None and not e.target.floating:
        return
    source = _vector(e, "base_pos", 3)
    if source is None:
        return
    height = float(np.nanmedian(e.of(source)[1].values[:, 2]))
    unit = "mm" if abs(height) > 30 else "m"
    evidence = [f"by {source.why}", f"height {height:.3g} -> {unit}"]
    if e.target is not None:
        usual = float(e.target.reference[2])
        evidence.append(f"the model's reference stands at {usual:.3g} m")
    e.settle("base_pos", source, range(3), tuple("xyz"), evidence, scale=1e-3 if unit == "mm" else 1.0, unit=unit)


def contact(e: Evidence) -> None:
    """Which foot stands: 0 and 1, or forces with a threshold."""
    candidates = [c for c in e.candidates_for("contact") if np.nanstd(e.of(c)[1].values) > 0]
    source = e.nearest(candidates)
    if source is None or e.target is None:
        return
    _, field = e.of(source)
    bodies, how = _feet(e, field.labels, field.width)
    if not bodies:
        e.warn(f"{source.label}: which foot is which is not known; it is left out")
        return
    values = field.values
    states = np.unique(values[np.isfinite(values)][:MOST])
    if len(states) <= 2 and set(states) <= {0.0, 1.0}:
        e.settle("contact", source, range(len(bodies)), bodies, [f"by {source.why}", how, "0 and 1"], unit="1")
        return
    flat = values[np.isfinite(values)]
    threshold = LIFTED * float(np.percentile(flat, 90))
    if (flat < threshold).mean() < 0.01:
        e.warn(f"{source.label}: no foot is ever lifted: left out")
        return
    text = f"a force: a foot stands above {threshold:.4g}, {LIFTED:.0%} of the 90th percentile"
    e.settle("contact", source, range(len(bodies)), bodies, [f"by {source.why}", how, text],
             unit="sensor units", threshold=threshold, doubtful=True)  # fmt: skip


def _feet(e: Evidence, labels: tuple[str, ...], width: int) -> tuple[list[str], str]:
    """(bodies of the columns, why)."""
    assert e.target is not None
    leaves = [e.target.model.body(b).name for b in e.target.leaves]
    lists = {"its columns name them": list(labels)} | {
        f"the feet of {n}": f for n, f in FEET.items() if len(f) == width
    }
    for how, names in lists.items():
        parts = [set(english(n)) for n in names]
        alike = set.intersection(*parts) if len(parts) > 1 else set()  # `foot`, which tells none from the others
        found = [[b for b in leaves if part - alike and part - alike <= set(english(b))] for part in parts]
        if len(found) == width and all(len(f) == 1 for f in found) and len({f[0] for f in found}) == width:
            return [f[0] for f in found], how
    return [], ""


def _vector(e: Evidence, role: str, width: int) -> Candidate | None:
    found = [
        c for c in e.candidates_for(role)
        if e.of(c)[1].width == width and np.nanmax(np.abs(e.of(c)[1].values), initial=0.0) > 0
    ]  # fmt: skip
    return e.nearest(found)


def _has_site(e: Evidence, source: Candidate) -> bool:
    """Whether the model says where the IMU sits; without a model that is not asked."""
    if e.target is None:
        return True
    if not e.target.imu_site:
        text = f'{source.label}: the model has no IMU site; add <site name="imu"/> to the body that carries it'
        if text not in e.proposal.missing:
            e.proposal.missing.append(text)
        return False
    e.proposal.imu_site = e.target.imu_site
    return True
