"""Read and validate a robot log and its nominal model."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

from realsim.core.errors import GapError, RealsimError, did_you_mean, refuse_unknown
from realsim.core.files import read_json
from realsim.core.models import load_mjcf
from realsim.core.notebook import table, traces
from realsim.core.types import MjModel, MjSpec
from realsim.gap.case.recordings import read_recordings
from realsim.gap.case.resolve import resolve
from realsim.gap.case.runs import Layout, layout, read_run
from realsim.gap.case.runs import Run as Run

KEYS = (
    "joint_names", "actuator_names", "command_kind", "command_hold", "base", "torque_kind", "imu_site",
    "contact_bodies", "notes", "columns", "units", "runs", "depth_camera",
)  # fmt: skip
"""What log.json may say."""

LEAST_TIMESTEP = 1e-5
"""Seconds: below, a log of seconds takes more memory than there is."""
MOST_GEOMS = 5000
"""Every candidate cause compiles and steps the model: beyond, a search would not end."""


FILTERS = (2, 3)
"""mjDYN_FILTER, mjDYN_FILTEREXACT: an actuator's activation follows its control with a first-order lag."""


@dataclass(frozen=True)
class Case:
    """A log and the simulator that the user believes in."""

    folder: Path
    joint_names: tuple[str, ...]
    actuator_names: tuple[str, ...]
    command_kind: str
    base: str
    torque_kind: str
    imu_site: str | None
    contact_bodies: tuple[str, ...]
    notes: str
    xml: str
    """Text of model.xml."""
    spec: MjSpec = field(repr=False)
    """mujoco.MjSpec of model.xml, resolved (realsim.gap.case.resolve); never edited, always copied."""
    model: MjModel = field(repr=False)
    """The compiled nominal mujoco.MjModel."""
    runs: tuple[Run, ...] = field(repr=False)
    warnings: tuple[str, ...] = ()
    dropped_runs: tuple[str, ...] = ()
    added: tuple[str, ...] = ()
    """Runs that were recorded afterwards, to tell causes apart: they are always fitted."""

    def __repr__(self) -> str:
        runs = f"{len(self.runs)} runs, {sum(run.duration for run in self.runs):.1f} s"
        return f"Case({str(self.folder)!r}, {len(self.joint_names)} joints, {self.base} base, {runs})"

    def _repr_html_(self) -> str:
        first = self.runs[0]
        signal = "joint_pos" if self.joint_names else "base_pos"
        drawn = np.asarray(first.signals[signal], float)
        rows = [
            ("case", str(self.folder)),
            ("robot", f"{self.base} base, joints {', '.join(self.joint_names)}"),
            ("runs", f"{len(self.runs)}, {sum(run.duration for run in self.runs):.1f} s"),
            ("signals", ", ".join(first.signals)),
            *(("note", warning) for warning in self.warnings),
            ("drawn", f"{signal} of {first.name}, {np.nanmin(drawn):.2g} to {np.nanmax(drawn):.2g} rad or m"),
        ]
        return f"<div>{table(rows)}{traces(drawn)}</div>"

    @property
    def floating(self) -> bool:
        return self.base == "floating"

    @property
    def has_imu(self) -> bool:
        """Whether a gyroscope or an accelerometer is logged and has its place in the model."""
        return self.imu_site is not None and (self.has("imu_gyro") or self.has("imu_acc"))

    @property
    def whole(self) -> bool:
        """Whether every run has the whole state: all joints and, where it floats, the base."""
        base = {"base_pos", "base_quat"} if self.floating else set()
        known = len(self.joint_names) + 6 * self.floating
        return (
            self.model.nv == known
            and self.model.na == len(self._filters)
            and all(base <= run.signals.keys() for run in self.runs)
        )

    def has(self, signal: str) -> bool:
        """Whether every run logged this signal with at least some finite samples."""
        return all(signal in r.signals and np.isfinite(r.signals[signal]).any() for r in self.runs)

    def with_runs(self, runs: tuple[Run, ...], *warnings: str) -> Case:
        """The same case with other runs and more notes."""
        return replace(self, runs=runs, warnings=self.warnings + tuple(warnings))

    def actuator_of(self, joint: str) -> str | None:
        """Name of the actuator that drives this joint, or None."""
        return self._actuators.get(joint)

    def gear(self, joint: str) -> float:
        """N m at the joint for 1 N m of its actuator, and the actuator's command for 1 rad; 1 without an actuator.

        Figures of the diagnosis are the joint's; gains, force ranges and commands of a model are the actuator's.
        """
        return self._gears.get(joint, 1.0)

    def slides(self, joint: str) -> bool:
        """Whether a joint moves along its axis, in m and N, and does not turn about it."""
        return int(self.model.joint(joint).type[0]) == 2  # mjJNT_SLIDE

    def command_torque(self, joint: str) -> float:
        """N m that its servo adds at once to the joint's torque for a unit of command; 0 without an actuator."""
        name = self.actuator_of(joint)
        return 0.0 if name is None else self.gear(joint) * float(self.model.actuator(name).gainprm[0])

    @cached_property
    def lags(self) -> dict[str, float]:
        """Actuator -> time constant of its own first-order filter in the model, s; without those of other dynamics."""
        import mujoco

        none = int(mujoco.mjtDyn.mjDYN_NONE)
        kinds = {name: int(self.model.actuator(name).dyntype[0]) for name in self.actuator_names}
        return {
            name: self._filters.get(name, 0.0) for name, kind in kinds.items() if kind == none or name in self._filters
        }

    @cached_property
    def _filters(self) -> dict[str, float]:
        return {
            a.name: float(a.dynprm[0])
            for a in map(self.model.actuator, range(self.model.nu))
            if a.dyntype[0] in FILTERS
        }

    @cached_property
    def _gears(self) -> dict[str, float]:
        return {joint: float(self.model.actuator(name).gear[0]) for joint, name in self._actuators.items()}

    @cached_property
    def _actuators(self) -> dict[str, str]:
        import mujoco

        found = {}
        for name in self.actuator_names:
            i = self.model.actuator(name).id
            if self.model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT:
                found[self.model.joint(self.model.actuator_trnid[i, 0]).name] = name
        return found


def load_case(folder: Path, recordings: Sequence[Path] = ()) -> Case:
    """Read a case folder of the contract (log.json, model.xml, runs/*.npz or *.csv).

    Args:
        recordings: further runs, in files like those of runs/, or folders of `realsim excite` with what was recorded.
            What is known to differ from model.xml in them stands in experiment.json beside them.

    Raises:
        GapError: with the file, what was expected and what was found; names are matched to the closest ones.
    """
    folder = Path(folder)
    given = quote(str(folder))
    if not folder.is_dir():
        raise GapError(
            "no such case", file=folder, expected="a folder with log.json, model.xml and runs/ with .npz or .csv",
            hint=f"of a model: realsim diagnose --init {given}; of a recording: realsim log {given} --model robot.xml"
            if folder.is_file() else None,
        )  # fmt: skip
    for name in ("log.json", "model.xml"):
        if not (folder / name).is_file():
            raise GapError(
                f"{name} is missing", file=folder, expected="log.json, model.xml and runs/ with .npz or .csv",
                hint=f"make a case of recordings: realsim log {given} --model robot.xml --out case; or of a model: "
                "realsim diagnose --init robot.xml --out case",
            )  # fmt: skip
    file = folder / "log.json"
    log = read_json(file)
    if not isinstance(log, dict):
        raise GapError("log.json is not an object", file=file)
    spec, model, xml = load_model(folder / "model.xml")
    entries = _Entries(log, file)
    base = entries.choice("base", ("fixed", "floating"))
    hinges = [model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] in (2, 3)]
    whole = base == "floating" and log.get("joint_names") == []  # a body that flies or rolls as a whole
    if whole and hinges:
        expected = f"those of {', '.join(hinges[:20])} that are logged"
        raise GapError("joint_names is empty, but the model has joints", file=file, expected=expected, found="[]")
    joints = [] if whole else entries.names("joint_names", "joint", [model.joint(i).name for i in range(model.njnt)])
    actuators = entries.names("actuator_names", "actuator", [model.actuator(i).name for i in range(model.nu)])
    for name in joints:
        if name not in hinges:
            expected = "hinge or slide joints in joint_names"
            raise GapError(f"joint {name!r} has more than one degree of freedom", file=file, expected=expected)
    site = log.get("imu_site")
    if site is not None:
        if not isinstance(site, str):
            raise GapError("imu_site cannot be read", file=file, expected="a name, or null", found=repr(site)[:60])
        entries.match([site], "imu_site", [model.site(i).name for i in range(model.nsite)])
    contact: list[str] = []
    if log.get("contact_bodies") not in (None, []):
        contact = entries.names("contact_bodies", "contact body", [model.body(i).name for i in range(model.nbody)])
    kind = entries.choice("command_kind", ("position", "velocity", "torque"))
    torque = entries.choice("torque_kind", ("none", "measured", "current_times_constant"), "none")
    if log.get("command_hold", "zoh") != "zoh":
        raise GapError("unknown command_hold", file=file, expected="zoh", found=str(log["command_hold"]))
    free = bool(model.njnt and (model.jnt_type == 0).any())
    if (base == "floating") != free:
        expected = f"base: {'floating' if free else 'fixed'} (model.xml {'has' if free else 'has no'} free joint)"
        raise GapError("base does not agree with the model", file=file, expected=expected, found=base)
    warnings = _unread(log)
    if model.ntendon:
        warnings.append(f"the model has {model.ntendon} tendons: they are simulated, but no effect acts on them")
    if model.neq:
        warnings.append(f"the model has {model.neq} equality constraints (closed loops): joints in them share causes")
    if unlogged := [n for n in hinges if n not in joints]:
        warnings.append(f"joints of the model that are not logged start at their default: {', '.join(unlogged[:6])}")
    log |= {"command_kind": kind, "columns": _columns(log, folder)}
    want = layout(joints, actuators, contact, model, log, file)
    runs, dropped = _read_runs(folder / "runs", want, warnings)
    for name in sorted(set(want.setups) - {d.partition(".")[0] for d in dropped}):
        refuse_unknown(name, [r.name for r in runs], f"runs of log.json name {name!r}, which is no run", file)
    added = read_recordings(recordings, want, model, [r.name for r in runs], warnings)
    runs += added
    if len(runs) == 1:
        warnings.append("only one run: none is left to check the diagnosis on, so it is weaker")
    return Case(
        folder, tuple(joints), tuple(actuators), kind, base, torque, site, tuple(contact), str(log.get("notes", "")),
        xml, spec, model, runs, tuple(warnings), dropped, tuple(r.name for r in added),
    )  # fmt: skip


@dataclass(frozen=True)
class _Entries:
    """The entries of log.json; what cannot be read is refused."""

    log: Mapping[str, Any]
    file: Path

    def names(self, key: str, kind: str, known: Sequence[str]) -> list[str]:
        """A list of names, each once, of parts of the model."""
        value = self.log.get(key)
        if not isinstance(value, list) or not value or not all(isinstance(v, str) for v in value):
            message = f"{key} {'is missing' if value is None else 'cannot be read'}"
            raise GapError(message, file=self.file, expected="a list of names", found=repr(value)[:60])
        if len(set(value)) != len(value):
            raise GapError(f"{key} names something twice", file=self.file, found=", ".join(value))
        self.match(value, kind, known)
        return value

    def match(self, names: Sequence[str], kind: str, known: Sequence[str]) -> None:
        for name in names:
            refuse_unknown(name, known, f"{kind} {name!r} is not in model.xml", self.file)

    def choice(self, key: str, allowed: Sequence[str], default: str | None = None) -> str:
        value = self.log.get(key, default)
        if value not in allowed:
            expected = " or ".join(allowed)
            raise GapError(f"{key} is not known", file=self.file, expected=expected, found=repr(value)[:60])
        return str(value)


def _unread(log: Mapping[str, Any]) -> list[str]:
    """A note on each entry of log.json that nothing reads: a slip of the pen would go unseen."""
    notes = []
    for key in sorted(set(log) - set(KEYS)):
        meant = did_you_mean(key, KEYS, 0.6)
        notes.append(f"log.json: {key!r} is not read" + (f" ({meant})" if meant else ""))
    return notes[:5]


def _read_runs(folder: Path, want: Layout, warnings: list[str]) -> tuple[tuple[Run, ...], tuple[str, ...]]:
    """(runs, what was left out and why). If no run can be used, the first one's error is raised."""
    files = sorted(f for f in folder.iterdir() if f.suffix in (".npz", ".csv")) if folder.is_dir() else []
    if not files:
        raise GapError("no runs", file=folder, expected="one .npz or .csv file per run")
    twice = sorted(stem for stem, count in Counter(f.stem for f in files).items() if count > 1)
    if twice:
        raise GapError("two files of one run", file=folder, found=", ".join(twice), hint="keep the .npz or the .csv")
    runs: list[Run] = []
    dropped, first = [], None
    known: dict[str, str] = {}
    for file in files:
        try:
            run = read_run(file, want, warnings)
        except RealsimError as error:
            first = first or error
            dropped.append(f"{file.name}: {error.message}")
            continue
        same = known.setdefault(run.samples, run.name)
        if same == run.name:
            runs.append(run)
        else:  # it would count twice, and be no check of the other
            dropped.append(f"{file.name}: the same samples as {same}")
    if not runs:
        assert first is not None
        raise first
    return tuple(runs), tuple(dropped)


def _columns(log: dict[str, Any], folder: Path) -> Any:
    """The map of .csv columns: in log.json, or in columns.json beside it, or none."""
    beside = folder / "columns.json"
    if beside.is_file():
        if "columns" in log:
            raise GapError("the column map is given twice", file=folder, found="columns in log.json, and columns.json")
        return read_json(beside)
    return log.get("columns")


def load_model(path: Path) -> tuple[Any, Any, str]:
    """(MjSpec resolved, MjModel, text) of an MJCF file that is safe to read. Raises GapError with the reason."""
    spec, model, text = load_mjcf(path, path.parent, resolve)
    if not LEAST_TIMESTEP <= model.opt.timestep <= 0.1:
        expected, found = f"timestep from {LEAST_TIMESTEP:g} to 0.1 s", f"{model.opt.timestep:g}"
        raise GapError("the model's time step cannot be simulated", file=path, expected=expected, found=found)
    if model.ngeom > MOST_GEOMS or model.nbody > MOST_GEOMS:
        raise GapError(
            "the model is too large for a diagnosis", file=path, expected=f"at most {MOST_GEOMS} bodies and geoms",
            found=f"{model.nbody} bodies, {model.ngeom} geoms", hint="leave out geoms that never touch anything",
        )  # fmt: skip
    if model.nu == 0:
        raise GapError("the model has no actuators", file=path, expected="the robot's servos as actuators")
    return spec, model, text
