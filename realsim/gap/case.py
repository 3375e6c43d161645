"""A robot log with its nominal simulator: read, checked, and said what is wrong with it."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from realsim.errors import GapError
from realsim.files import check_size, inside, read_json, read_text
from realsim.types import F64

SIGNAL_SHAPES: dict[str, str | int] = {
    "joint_pos": "J",
    "joint_vel": "J",
    "joint_torque": "J",
    "base_pos": 3,
    "base_quat": 4,
    "imu_gyro": 3,
    "imu_acc": 3,
    "contact": "F",
}
MAX_SAMPLES = 5_000_000


@dataclass(frozen=True)
class Run:
    """One trajectory on the robot. Arrays as in the contract; missing samples are NaN."""

    name: str
    time: F64
    """(T,) seconds, strictly increasing, the first is 0."""
    command: F64
    """(T, U), held between samples."""
    signals: dict[str, F64]
    """joint_pos (T, J) and whatever else was logged."""
    init_qpos: F64 | None = None
    init_qvel: F64 | None = None

    @property
    def duration(self) -> float:
        return float(self.time[-1] - self.time[0])


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
    spec: Any = field(repr=False)
    """mujoco.MjSpec of model.xml; never edited, always copied."""
    model: Any = field(repr=False)
    """The compiled nominal mujoco.MjModel."""
    runs: tuple[Run, ...] = field(repr=False)
    warnings: tuple[str, ...] = ()
    dropped_runs: tuple[str, ...] = ()

    @property
    def floating(self) -> bool:
        return self.base == "floating"

    @property
    def has_imu(self) -> bool:
        return self.imu_site is not None and all("imu_gyro" in r.signals for r in self.runs)

    def has(self, signal: str) -> bool:
        """Whether every run logged this signal with at least some finite samples."""
        return all(signal in r.signals and np.isfinite(r.signals[signal]).any() for r in self.runs)

    def with_runs(self, runs: tuple[Run, ...], *warnings: str) -> Case:
        """The same case with other runs, and more said about it."""
        return replace(self, runs=runs, warnings=self.warnings + tuple(warnings))

    def actuator_of(self, joint: str) -> str | None:
        """Name of the actuator that drives this joint, or None."""
        return _actuators(self).get(joint)


def _actuators(case: Case) -> dict[str, str]:
    import mujoco

    found = {}
    for name in case.actuator_names:
        i = case.model.actuator(name).id
        if case.model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT:
            found[case.model.joint(case.model.actuator_trnid[i, 0]).name] = name
    return found


def load_case(folder: Path) -> Case:
    """Read a case folder of the contract (log.json, model.xml, runs/*.npz).

    Raises:
        GapError: with the file, what was expected and what was found; names are matched to the closest ones.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise GapError("no such case", file=folder, expected="a folder with log.json, model.xml and runs/*.npz")
    for name in ("log.json", "model.xml"):
        if not (folder / name).is_file():
            raise GapError(f"{name} is missing", file=folder, expected="log.json, model.xml and runs/*.npz")
    log = read_json(folder / "log.json")
    if not isinstance(log, dict):
        raise GapError("log.json is not an object", file=folder / "log.json")
    spec, model, xml = _load_model(folder / "model.xml")
    joints = _names(log, "joint_names", folder)
    actuators = _names(log, "actuator_names", folder)
    _match(joints, [model.joint(i).name for i in range(model.njnt)], "joint", folder)
    _match(actuators, [model.actuator(i).name for i in range(model.nu)], "actuator", folder)
    for name in joints:
        if model.joint(name).type[0] not in (2, 3):
            raise GapError(
                f"joint {name!r} has more than one degree of freedom",
                file=folder / "log.json",
                expected="hinge or slide joints in joint_names",
            )
    warnings: list[str] = []
    site = log.get("imu_site")
    if site is not None:
        _match([site], [model.site(i).name for i in range(model.nsite)], "imu_site", folder)
    contact = [str(b) for b in log.get("contact_bodies") or []]
    _match(contact, [model.body(i).name for i in range(model.nbody)], "contact body", folder)
    kind = _choice(log, "command_kind", ("position", "velocity", "torque"), folder)
    base = _choice(log, "base", ("fixed", "floating"), folder)
    torque = _choice(log, "torque_kind", ("none", "measured", "current_times_constant"), folder, default="none")
    if log.get("command_hold", "zoh") != "zoh":
        raise GapError("unknown command_hold", file=folder / "log.json", expected="zoh", found=str(log["command_hold"]))
    free = bool(model.njnt and (model.jnt_type == 0).any())
    if (base == "floating") != free:
        raise GapError(
            "base does not agree with the model",
            file=folder / "log.json",
            expected=f"base: {'floating' if free else 'fixed'} (model.xml {'has' if free else 'has no'} free joint)",
            found=base,
        )
    if model.ntendon:
        warnings.append(f"the model has {model.ntendon} tendons: they are simulated, but no effect acts on them")
    if model.neq:
        warnings.append(f"the model has {model.neq} equality constraints (closed loops): joints in them share causes")
    unlogged = [model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] in (2, 3)]
    unlogged = [n for n in unlogged if n not in joints]
    if unlogged:
        warnings.append(f"joints of the model that are not logged start at their default: {', '.join(unlogged[:6])}")
    files = sorted((folder / "runs").glob("*.npz")) if (folder / "runs").is_dir() else []
    if not files:
        raise GapError("no runs", file=folder / "runs", expected="one .npz file a run")
    shape = {"J": len(joints), "U": len(actuators), "F": len(contact)}
    runs, dropped, first = [], [], None
    for file in files:
        try:
            runs.append(read_run(file, shape, model.nq, model.nv, warnings))
        except GapError as error:
            first = first or error
            dropped.append(f"{file.name}: {error.message}")
    if not runs:
        assert first is not None
        raise first
    if len(runs) == 1:
        warnings.append("only one run: nothing is left to check the diagnosis on, so it is weaker")
    return Case(
        folder, tuple(joints), tuple(actuators), kind, base, torque, site, tuple(contact), str(log.get("notes", "")),
        xml, spec, model, tuple(runs), tuple(warnings), tuple(dropped),
    )  # fmt: skip


def _load_model(path: Path) -> tuple[Any, Any, str]:
    import mujoco
    from defusedxml import ElementTree
    from defusedxml.common import DefusedXmlException

    text = read_text(path)
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, DefusedXmlException) as error:
        raise GapError("model.xml is not plain XML", file=path, found=str(error)) from error
    for node in root.iter():
        if node.get("file"):
            inside(path.parent, node.get("file", ""))
        if node.tag == "plugin" or node.tag == "extension":
            raise GapError("models with plugins are not loaded", file=path, found=f"<{node.tag}>")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        model = spec.copy().compile()
    except Exception as error:  # MuJoCo raises ValueError and its own types
        raise GapError("model.xml does not compile", file=path, found=str(error).splitlines()[0]) from error
    if model.nu == 0:
        raise GapError("the model has no actuators", file=path, expected="the robot's servos as actuators")
    return spec, model, text


def read_run(path: Path, shape: dict[str, int], nq: int, nv: int, warnings: list[str]) -> Run:
    """One npz file. Raises GapError for what cannot be used; adds to `warnings` what was mended."""
    check_size(path)
    try:
        with np.load(path, allow_pickle=False) as archive:
            data = {k: np.asarray(archive[k], dtype=np.float64) for k in archive.files}
    except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
        raise GapError("not a readable .npz of plain numbers", file=path, found=str(error)) from error
    for name in ("time", "command", "joint_pos"):
        if name not in data:
            raise GapError(f"array {name!r} is missing", file=path, found=", ".join(sorted(data)) or "nothing")
    time = data["time"].reshape(-1)
    count = len(time)
    if count < 20:
        raise GapError("the run is too short", file=path, expected="at least 20 samples", found=str(count))
    if count > MAX_SAMPLES:
        raise GapError("the run is too long", file=path, expected=f"at most {MAX_SAMPLES} samples", found=str(count))
    _check_shape(path, "command", data["command"], (count, shape["U"]))
    signals = {}
    for name, columns in SIGNAL_SHAPES.items():
        width = shape[columns] if isinstance(columns, str) else int(columns)
        if name in data and width:
            _check_shape(path, name, data[name], (count, width))
            signals[name] = np.where(np.isfinite(data[name]), data[name], np.nan)
    if not np.isfinite(signals["joint_pos"]).any(axis=0).all():
        empty = int(np.flatnonzero(~np.isfinite(signals["joint_pos"]).any(axis=0))[0])
        raise GapError("a joint has no finite position", file=path, found=f"column {empty} of joint_pos is all NaN")
    keep = np.isfinite(time)
    if not keep.all():
        warnings.append(f"{path.name}: {int((~keep).sum())} samples without a time stamp are left out")
    back = np.zeros(count, bool)
    latest = -np.inf
    for i in np.flatnonzero(keep):  # a stamp is late if any earlier one is as new: order cannot be trusted there
        back[i] = time[i] <= latest
        latest = max(latest, time[i])
    if back.sum() > 0.05 * count:
        raise GapError(
            "the clock runs backwards",
            file=path,
            expected="increasing time",
            found=f"{int(back.sum())} of {count} steps do not increase, the first at sample {int(np.argmax(back))}",
            hint="sort the log by the robot's own clock",
        )
    if back.any():
        warnings.append(f"{path.name}: the clock runs backwards at {int(back.sum())} samples, which are left out")
    keep &= ~back
    command = _fill_forward(data["command"], path, warnings)
    if np.ptp(time[keep]) > 3600:
        raise GapError(
            "the run lasts more than an hour",
            file=path,
            found=f"{np.ptp(time[keep]):.3g} s",
            hint="is time in seconds?",
        )
    qpos, qvel = data.get("init_qpos"), data.get("init_qvel")
    if qpos is not None and (qpos.shape != (nq,) or not np.isfinite(qpos).all()):
        raise GapError("init_qpos does not fit the model", file=path, expected=f"({nq},) finite", found=str(qpos.shape))
    if qvel is not None and (qvel.shape != (nv,) or not np.isfinite(qvel).all()):
        raise GapError("init_qvel does not fit the model", file=path, expected=f"({nv},) finite", found=str(qvel.shape))
    return Run(
        path.stem, time[keep] - time[keep][0], command[keep], {k: v[keep] for k, v in signals.items()}, qpos, qvel
    )


def _check_shape(path: Path, name: str, array: F64, want: tuple[int, int]) -> None:
    if array.shape != want:
        raise GapError(f"{name} has the wrong shape", file=path, expected=str(want), found=str(array.shape))


def _fill_forward(command: F64, path: Path, warnings: list[str]) -> F64:
    """A missing command is the one before it: that is what a held command does."""
    bad = ~np.isfinite(command)
    if not bad.any():
        return command
    if bad.all(axis=0).any() or bad.mean() > 0.5:
        raise GapError("the command is missing", file=path, found=f"{bad.mean():.0%} of the samples are not finite")
    warnings.append(f"{path.name}: {int(bad.any(axis=1).sum())} samples without a command hold the one before")
    filled = command.copy()
    for column in range(command.shape[1]):
        good = np.flatnonzero(~bad[:, column])
        source = good[np.clip(np.searchsorted(good, np.arange(len(command)), side="right") - 1, 0, None)]
        filled[:, column] = command[source, column]
    return filled


def _names(log: dict[str, Any], key: str, folder: Path) -> list[str]:
    value = log.get(key)
    if not isinstance(value, list) or not value or not all(isinstance(v, str) for v in value):
        raise GapError(
            f"{key} is missing", file=folder / "log.json", expected="a list of names", found=repr(value)[:60]
        )
    if len(set(value)) != len(value):
        raise GapError(f"{key} names something twice", file=folder / "log.json", found=", ".join(value))
    return value


def _match(names: list[str], known: list[str], kind: str, folder: Path) -> None:
    for name in names:
        if name not in known:
            close = get_close_matches(name, known, n=3, cutoff=0.3)
            raise GapError(
                f"{kind} {name!r} is not in model.xml",
                file=folder / "log.json",
                expected=f"one of {', '.join(known[:40])}",
                hint=f"did you mean {' or '.join(close)}?" if close else None,
            )


def _choice(log: dict[str, Any], key: str, allowed: tuple[str, ...], folder: Path, default: str | None = None) -> str:
    value = log.get(key, default)
    if value not in allowed:
        raise GapError(
            f"{key} is not known", file=folder / "log.json", expected=" or ".join(allowed), found=repr(value)[:60]
        )
    return str(value)
