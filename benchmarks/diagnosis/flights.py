"""Real flights of two Crazyflies with known damage (CrazyPAD), a case a flight.

    python benchmarks/diagnosis/flights.py --jobs 2          # needs the flights (shared/real_logs/crazypad)

The model is the published one. Of each drone, every other normal flight gives how much of the firmware's thrust its
propellers give, the place of its centre of mass and how its propellers' drags differ, by the mean thrusts in the air,
and the motors' lag, by the vertical acceleration: what is left is what was done to the drone, and its battery, which
lies otherwise and is at another voltage in every flight. The other flights are diagnosed, in windows of two seconds in
the air; three without the yaw in their log (propeller cut by 3 mm, E8) are not.
"""

import os
import shutil
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from scipy.ndimage import uniform_filter1d

from benchmarks.diagnosis.hardware.logs import Arrays, windows_of
from benchmarks.diagnosis.pool import Job, diagnose_all, read
from benchmarks.diagnosis.put_in import options, sizes
from benchmarks.diagnosis.real import NAMES
from benchmarks.store import Row, Store
from realsim.core.files import to_json, write_text
from realsim.gap.provenance import engine
from realsim.gap.recordings import read as read_recording
from realsim.gap.simulation.control import lagged
from tests.truths.written import write_case

ARM = 0.046 / np.sqrt(2)
"""m: M1 front right, M2 back right, M3 back left, M4 front left, 46 mm from the centre."""
MASS = 0.0321
"""kg, with the decks for the log and for the place."""
LAGS = np.arange(0.01, 0.2, 0.01)
"""s, time constants that are tried."""
LATEST = 6
"""Samples."""
DEVIATIONS = "deviations.json"
"""How far the centre of mass is moved between normal flights: the battery is taken out."""
PLACES = ARM * np.array([(1, -1), (-1, -1), (-1, 1), (1, 1)])
DRAG = 5.964552e-3
"""N m of torque about a rotor's axis for each newton of its thrust (Foerster, ETH 2015)."""
GRAVITY, HEIGHT, WINDOW = 9.81, 0.3, 2.0
"""m/s2; m above which it flies; seconds of a window."""
KINDS = {
    "normal_flight": "", "add_weight_W1_near_M4": "mass", "add_weight_W3_near_M3": "mass",
    "weight_on_string_W2_near_M3": "mass", "cut_propeller_M3_2mm_2mm_43mm": "thrust", "cut_propeller_M3_3mm": "thrust",
    "tape_on_propeller_M3": "thrust",
}  # fmt: skip
"""Condition -> what it is; the motor stands at the end of the name."""
SORTS = {"payload": "mass", "com_offset": "mass", "thrust_gain": "thrust"}
"""Inertia without mass is neither: seven times the model's is what motors that answer late look like."""


def main() -> int:
    parser = options(__doc__, "out/gap_flights")
    parser.add_argument("--shared", type=Path, default=Path(os.environ.get("REALSIM_SHARED", "../shared")))
    args = parser.parse_args()
    wanted = jobs(args.shared, args.work)
    wanted = {n: job for n, job in wanted.items() if not args.only or any(o in n for o in args.only)}
    diagnose_all([job for both in wanted.values() for job in both], args.jobs, args.minutes)
    store = Store(args.store or args.work / "rows.json", ("case", "engine"))
    rows = [store.add(row) for row in answered(wanted)]
    for r in rows:
        print(f"{r['case']:<44} {r['verdict']:<17} {r['kind']:<8} {'; '.join(r['sizes'])}\n"
              f"{'':<44} since a normal flight: {r['since']}, {'; '.join(r['changes'])}")  # fmt: skip
    damaged, normal = [r for r in rows if r["truth"]], [r for r in rows if not r["truth"]]
    for what, right, place in (("named", "kind_right", "arm_right"), ("changed", "change_right", "change_arm_right")):
        rightly = [f"{sum(r[flag] for r in damaged)}/{len(damaged)}" for flag in (right, place)]
        silent = f"{sum(r[right] for r in normal)}/{len(normal)}"
        print(f"{what}: kind right {rightly[0]}; arm {rightly[1]}; normal flights without a name {silent}")
    print(f"verdicts {dict(Counter(r['verdict'] for r in rows))}")
    return 0


def jobs(shared: Path, work: Path) -> dict[str, tuple[Job, Job]]:
    """Flight -> its diagnosis, with what normal flights differ by as everyday deviations, and what changed since a
    normal flight of the same drone."""
    names = make(shared, work / "cases")
    earlier = {name[-8:-6]: name for name in reversed(names) if name.startswith("normal")}
    found = {}
    for n in names:
        first, case = earlier[n[-8:-6]], work / "cases" / n
        named = Job(case, work / engine() / "named" / n, {"deviations": work / "cases" / DEVIATIONS})
        since = work / "cases" / first if n != first else None
        found[n] = named, Job(case, work / engine() / "changed" / n, since=since)
    return found


def answered(wanted: dict[str, tuple[Job, Job]]) -> list[Row]:
    """Rows of the flights of which both answers are there."""
    answers = {n: [read(job) for job in both] for n, both in wanted.items()}
    return [judged(n, named, changed) for n, (named, changed) in answers.items() if named and changed]


def make(shared: Path, folder: Path) -> list[str]:
    """Write the cases that are not there yet; names of all."""
    flights = sorted((shared / "real_logs" / "crazypad").glob("*/E*"))
    names, apart = [], []
    for drone in ("E8", "E9"):
        mine = [f for f in flights if f.name.startswith(drone)]
        normal = [f for f in mine if f.parent.name == "normal_flight"]
        parts = [flight(f) for f in normal[::2]]
        model = xml_of([part for found in parts for part in found])
        apart.append(np.var([centre([part["command"] for part in found]) for found in parts], axis=0, ddof=1))
        for file in mine:
            if file in normal[::2] or not (found := flight(file)):
                continue
            names.append(f"{file.parent.name}__{file.name}")
            if not (folder / names[-1] / "log.json").is_file():
                shutil.rmtree(folder / names[-1], ignore_errors=True)
                runs: dict[str, Arrays] = {}
                for k, part in enumerate(found):
                    del part["acceleration"]
                    runs |= windows_of(f"{file.name}_{k}", part, WINDOW)
                write_case(folder / names[-1], model, runs, command_kind="torque")
    sizes_of = dict(zip("xy", np.sqrt(np.mean(apart, axis=0)).tolist(), strict=True))
    write_text(folder / DEVIATIONS, to_json({"com_offset": sizes_of}))
    return names


def centre(commands: list[np.ndarray]) -> np.ndarray:
    """(2,) m: the place of the centre of mass that the mean of thrusts (T, 4) balances."""
    mean = np.concatenate(commands).mean(axis=0)
    return mean @ PLACES / mean.sum()


def flight(file: Path) -> list[dict[str, np.ndarray]]:
    """What a case's runs hold of a file: each stretch in the air, as it lands on the way; none without an attitude."""
    (recording,) = read_recording(file)
    (stream,) = recording.streams
    if "base_quat" not in stream.fields:
        return []
    names = {"command": "motor thrust command", "base_pos": "base_pos", "base_quat": "base_quat",
             "acceleration": "stateEstimate.a"}  # fmt: skip
    arrays = {k: stream.fields[name].values for k, name in names.items()} | {"time": stream.clocks["header"]}
    up = (arrays["base_pos"][:, 2] > HEIGHT) & (arrays["command"].sum(axis=1) > 0.15)
    edges = np.flatnonzero(np.diff(up, prepend=False, append=False))
    parts = [{k: v[begin:end] for k, v in arrays.items()} for begin, end in edges.reshape(-1, 2)]
    parts = [part for part in parts if np.ptp(part["time"]) > WINDOW / 2]
    return [part | {"time": part["time"] - part["time"][0]} for part in parts]


def xml_of(parts: list[dict[str, np.ndarray]]) -> str:
    """The published model with the thrusts, the centre of mass, the ratio of the two kinds of propellers' drag and the
    lag of the motors that some flights show."""
    mean = np.concatenate([part["command"] for part in parts]).mean(axis=0)
    drag = DRAG * np.sqrt((mean[[1, 3]].sum() / mean[[0, 2]].sum()) ** np.array([1, -1, 1, -1])) * [-1, 1, -1, 1]
    x, y = centre([part["command"] for part in parts])
    share, lag = (
        MASS * GRAVITY / mean.sum(),
        LAGS[np.argmax([np.mean([_follows(part, s) for part in parts]) for s in LAGS])],
    )
    sites = "".join(f'<site name="s{k}" pos="{p[0]:.6f} {p[1]:.6f} 0"/>' for k, p in enumerate(PLACES, 1))
    motors = "".join(
        f'<general name="m{k}" site="s{k}" gear="0 0 1 0 0 {d:.6f}" gainprm="{share:.4f}" dyntype="filterexact" '
        f'dynprm="{lag:.3f}"/>'
        for k, d in enumerate(drag, 1)
    )
    return f"""<mujoco model="crazyflie"><option timestep="0.005" integrator="implicitfast"/><worldbody>
<body name="cf2" pos="0 0 0.5"><freejoint/>{sites}
<inertial pos="{x:.6f} {y:.6f} 0" mass="{MASS}" diaginertia="2.3951e-5 2.3951e-5 3.2347e-5"/></body>
</worldbody><actuator>{motors}</actuator></mujoco>"""


def _follows(part: dict[str, np.ndarray], lag: float) -> float:
    """Largest correlation of the vertical acceleration, which the drone estimates some samples late, with the thrust
    behind a lag (s), both without what is slower than 1 s."""
    step = float(np.median(np.diff(part["time"])))
    thrust = lagged(part["command"].sum(axis=1), lag, step)
    sent, seen = (v - uniform_filter1d(v, round(1 / step)) for v in (thrust, part["acceleration"][:, 2]))
    return max(float(np.corrcoef(sent[: len(sent) - k], seen[k:])[0, 1]) for k in range(LATEST))


def judged(name: str, found: Row, changed: Row) -> Row:
    """The row of a flight, by its diagnosis and by the one beside a normal flight."""
    condition, _, log = name.partition("__")
    named = found["causes"] if found["verdict"] in NAMES else []
    since = changed.get("since") or {"verdict": "not compared", "changes": []}
    truth = KINDS[condition]
    answered = found["verdict"] not in ("crashed", "refused")
    motor = next((p for p in condition.split("_") if p in ("M3", "M4")), "")
    return {
        "case": name, "engine": found["provenance"]["engine"], "drone": log[:2], "truth": truth, "kind": kind(named),
        "verdict": found["verdict"], "sizes": sizes(found), "kind_right": answered and kind(named) == truth,
        "arm_right": bool(named) and arm(named[0]) == motor, "since": since["verdict"],
        "changes": sizes({"causes": since["changes"]}), "change_right": kind(since["changes"]) == truth,
        "change_arm_right": bool(since["changes"]) and arm(since["changes"][0]) == motor,
        "seconds": found.get("seconds"), "cpu_seconds": found.get("cpu_seconds"),
        "said": found.get("said") or found.get("sentence"),
    }  # fmt: skip


def kind(causes: list[Row]) -> str:
    """Mass, thrust, or the effect's own name; empty where nothing is named."""
    return SORTS.get(causes[0]["effect"], causes[0]["effect"]) if causes else ""


def arm(cause: Row) -> str:
    """The motor that a cause is at: by its name, or the nearest to where a mass sits."""
    if named := cause.get("actuators"):
        return str(named[0]).upper() if len(named) == 1 else ""
    at = [(p := cause["parameters"].get(axis, {})).get("value", p.get("now")) for axis in "xy"]
    if None in at:
        return ""
    return f"M{1 + int(np.argmin(np.linalg.norm(PLACES - np.array(at), axis=1)))}"


if __name__ == "__main__":
    raise SystemExit(main())
