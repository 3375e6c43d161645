"""The batch simulator: runs of a case, replayed by the nominal model or by one that effects have changed."""

from __future__ import annotations

import copy
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from realsim.core.errors import GapError, RealsimError
from realsim.core.filters import low_passed
from realsim.core.progress import stop_requested
from realsim.core.types import F64, Bool, MjModel
from realsim.gap.case.case import Case, Run
from realsim.gap.case.model.channels import Channel as Channel
from realsim.gap.case.model.channels import channels
from realsim.gap.case.model.context import Context, build_context, measure
from realsim.gap.case.model.edit import Edit
from realsim.gap.case.motion import velocity_lag
from realsim.gap.config import DiagnoseConfig
from realsim.gap.effects.base import Place
from realsim.gap.effects.deviations_file import check_places, read_deviations
from realsim.gap.effects.lookup import SINCE, lookup
from realsim.gap.simulation.anchors import anchored
from realsim.gap.simulation.control import controls, switched_off, tracks_of
from realsim.gap.simulation.cores import Cores, Recent
from realsim.gap.simulation.sampling import continuous_turn, either_side, nearest_turn
from realsim.gap.simulation.sampling import quiet_mujoco as quiet_mujoco
from realsim.gap.simulation.sampling import rotation_from as rotation_from
from realsim.gap.simulation.sampling import sample as sample
from realsim.gap.simulation.start import find_starts
from realsim.gap.simulation.state import Start, first_rows, initial_state
from realsim.gap.simulation.stepping import Roller, gears, rolled, spare, stepped, switched, waves

Setting = tuple[str, Place, dict[str, float]]
"""(effect name, place, coordinates by parameter name; missing ones keep their defaults)."""

KEPT = 3
"""Roll-outs that are kept: of the nominal simulator at coarser steps, and of changed ones."""

RESTING = 0.06
"""Seconds that are enough for contacts to take up their load."""


class OutOfTime(RealsimError):
    """The time of a search is over (`Simulator.stop_after`): whoever has an answer so far gives that one."""


class Simulator:
    """Replays runs. `simulate` returns, for each run, (T, C) at the logged time stamps; NaN from where it failed.

    A run begins after the first command was held for `settle_seconds` from the logged initial pose, so that a changed
    model starts from its own rest; one that was recorded out of rest begins in the state of the log (`starts`, see
    realsim.gap.simulation.start). Held commands are averaged over simulation steps, which makes delays of a fraction
    of a step exact in the mean.
    """

    def __init__(
        self, case: Case, config: DiagnoseConfig, known: Sequence[int] | None = None, planned: bool = False
    ) -> None:
        """
        Args:
            known: runs that scales of effects (peak torque, travel) are taken from; all if None.
            planned: whether the runs are yet to be recorded: each begins at rest, and goes on from no state of a log.
        """
        self.case, self.config = case, config
        self.known = tuple(range(len(case.runs)) if known is None else known)
        self.context: Context = build_context(case)
        self.channels = channels(case)
        self.velocity_lag = velocity_lag(case)
        """s of the filter that the log's velocities come through."""
        self._turned = {
            r.name: (first_rows(q), logged_turn(r)) for r in case.runs if (q := r.signals.get("base_quat")) is not None
        }
        """Run -> the base's first orientation, and how it turned from there."""
        self.simulated_seconds = 0.0
        self._end = np.inf
        self.cores = Cores(config.threads)
        self._counting = threading.Lock()
        self._raw: list[dict[str, F64]] | None = None
        self._coarse: Recent[list[dict[str, F64]]] = Recent(KEPT)
        self._changed: Recent[list[dict[str, F64]]] = Recent(KEPT)
        self._begun: Recent[Edit] = Recent(KEPT)
        """Simulators with what many calls share, before anything of their own."""
        self._controls: Recent[tuple[Start, F64]] = Recent(8 * KEPT)
        """Of the runs, and how these begin."""
        self._steps: dict[str, F64] = {}
        """Run -> what new commands add to the torque."""
        self.starts: tuple[Start, ...] = tuple(Start() for _ in case.runs)
        """How each run begins."""
        self.base: tuple[Setting, ...] = ()
        """What every simulation contains."""
        self._raw = self.roll_out(Edit(self.context), None)
        self.rests = [r["pos"][round(float(r["settle"][0] / r["settle"][1]))] for r in self._raw]
        """(J,) a run: where the nominal simulator rests under the first command."""
        if not planned:
            self._start_in_motion()
        self.context.travels = self._travels(self.known)
        self.context.deviations = read_deviations(config.deviations)
        measure(self.context, [_inside(self._raw[i]) for i in self.known])
        check_places(self.context.deviations, lambda name: lookup(name).places(self.context), self.context)

    def close(self) -> None:
        self.cores.close()

    def stop_after(self, seconds: float) -> None:
        """From so many seconds on, or from an interrupt before, simulating raises OutOfTime; never if infinite."""
        self._end = time.monotonic() + seconds

    def context_of_all_runs(self) -> Context:
        """The context with scales of the unknown runs too: for what may be recorded next, not for fits."""
        context = replace(
            self.context, peak_torque={}, speed={}, mean_torque={}, mean_speed={}, load_at_speed={}, inertial_share={},
            reversals={}, load_reversals={},
        )  # fmt: skip
        context.travels = self._travels(range(len(self.case.runs)))
        measure(context, [_inside(track) for track in self.nominal_tracks])
        return context

    def _travels(self, runs: Sequence[int]) -> dict[str, float]:
        """Joint -> range of its positions in these runs, rad or m."""
        logged = np.concatenate([self.case.runs[i].signals["joint_pos"] for i in runs])
        ranges = np.nan_to_num(np.fmax.reduce(logged) - np.fmin.reduce(logged))
        return dict(zip(self.case.joint_names, map(float, ranges), strict=True))

    def __enter__(self) -> Simulator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def nominal_tracks(self) -> list[dict[str, F64]]:
        """pos, vel, torque (N, J) on the simulator's own grid, a dict a run."""
        assert self._raw is not None
        return self._raw

    def begin_from(self, settings: Sequence[Setting]) -> None:
        """Let every simulation contain these settings from now on; the nominal one, too."""
        self.base = tuple(settings)
        self._raw = self.roll_out(self.edited(()), None)

    def edited(
        self,
        settings: Sequence[Setting],
        onsets: Mapping[str, float] | None = None,
        beside: Sequence[Setting] = (),
    ) -> Edit:
        """The changed simulator; effects that end in SINCE change the runs of the later log alone.

        `onsets`: run -> s at which a force begins that comes at a moment of its own in each. `beside`: settings that
        come first, and that many calls share.
        """
        if not (self.base or any(s[0].endswith(SINCE) for s in (*settings, *beside))):
            key = tuple((name, place, *values.items()) for name, place, values in beside)
            return self._applied(self._begun.get(key, lambda: self._edited(beside, None)).copied(), settings, onsets)
        settings = [*beside, *settings]
        always = [*self.base, *(s for s in settings if not s[0].endswith(SINCE))]
        changes = [s for s in settings if s[0].endswith(SINCE)]
        edit = self._edited(self._summed(always) if self.base else always, onsets)
        if changes:
            edit.later = self._edited(self._summed([*always, *changes]), onsets)
        return edit

    def _summed(self, settings: Sequence[Setting]) -> list[Setting]:
        """Settings of one effect at one place added, coordinate by coordinate; changes to what they change."""
        found: dict[tuple[str, Place], dict[str, float]] = {}
        for name, place, values in settings:
            own = name.removesuffix(SINCE)
            here = found.setdefault((own, place), {})
            for p in lookup(own).parameters(self.context, place):
                if p.name in values:
                    moved = here.get(p.name, p.default) + values[p.name] - p.default
                    here[p.name] = float(np.clip(moved, *p.bounds))
        return [(name, place, values) for (name, place), values in found.items()]

    def _edited(self, settings: Sequence[Setting], onsets: Mapping[str, float] | None) -> Edit:
        return self._applied(Edit(self.context), settings, onsets)

    def _applied(self, edit: Edit, settings: Sequence[Setting], onsets: Mapping[str, float] | None) -> Edit:
        edit.onsets = dict(onsets or {})
        for name, place, values in settings:
            effect = lookup(name)
            full = {p.name: p.default for p in effect.parameters(self.context, place)}
            unknown = set(values) - set(full)
            if unknown:
                raise GapError(f"{name} has no parameter {sorted(unknown)[0]!r}", expected=", ".join(full))
            requests = edit.requests
            effect.apply(edit, place, full | values)
            if edit.requests > requests:
                edit.bodily.append((name, place, values))
        return edit

    def simulate(
        self,
        settings: Sequence[Setting] = (),
        runs: Sequence[int] | None = None,
        coarse: int = 1,
        onsets: Mapping[str, float] | None = None,
        beside: Sequence[Setting] = (),
    ) -> list[F64]:
        """(T, C) a run, of the runs with these indices (all if None); `coarse` multiplies the time step; see `edited`
        for `onsets` and `beside`."""
        chosen = list(range(len(self.case.runs))) if runs is None else list(runs)
        edit = self.edited(settings, onsets, beside)
        raw = self._raw_of(edit, chosen, coarse)
        return [self.read(self.case.runs[i], r, edit) for i, r in zip(chosen, raw, strict=True)]

    def moves(self, setting: Setting) -> bool:
        """Whether the robot moves otherwise, or is read at other times; if not, only what is read is shifted."""
        edit = self.edited([setting])
        edit = edit.later or edit
        return bool(edit.touched or edit.signals.moves_the_robot() or edit.signals.observation_delay)

    def _raw_of(self, edit: Edit, chosen: list[int], coarse: int) -> list[dict[str, F64]]:
        """Signals on the simulator's own grid; what only reads them otherwise needs no simulation of its own."""
        if edit.later is not None:
            found: dict[int, dict[str, F64]] = {}
            alone = copy.copy(edit)
            alone.later = None
            for changed, here in ((False, alone), (True, edit.later)):
                part = [i for i in chosen if self.case.runs[i].setup.later is changed]
                found |= dict(zip(part, self._raw_of(here, part, coarse) if part else (), strict=True))
            return [found[i] for i in chosen]
        moving = any(self.starts[i].reads_the_log for i in chosen)
        moves = edit.touched or edit.signals.moves_the_robot() or (moving and edit.signals.observation_delay)
        if coarse == 1 and not moves:
            assert self._raw is not None
            return [self._raw[i] for i in chosen]
        motion = repr((edit.bodily, edit.onsets)), edit.signals.motion(moving), coarse, tuple(chosen)
        return (self._changed if moves else self._coarse).get(motion, lambda: self.roll_out(edit, chosen, coarse))

    # ------------------------------------------------------------ inside

    def _start_in_motion(self) -> None:
        """Simulate again the runs that do not begin at rest."""
        assert self._raw is not None
        edit = Edit(self.context)
        self.starts = find_starts(
            self, [self.read(run, raw, edit) for run, raw in zip(self.case.runs, self._raw, strict=True)]
        )
        self.starts = anchored(self)
        moving = [i for i, start in enumerate(self.starts) if start.reads_the_log]
        for i, raw in zip(moving, self.roll_out(edit, moving) if moving else [], strict=True):
            self._raw[i] = raw

    def roll_out(
        self,
        edit: Edit,
        chosen: list[int] | None,
        coarse: int = 1,
        starts: Sequence[Start] | None = None,
        seconds: float = np.inf,
    ) -> list[dict[str, F64]]:
        """Signals on the simulator's own grid, a dict a run; begun as in `starts` (the runs' own if None)."""
        begun = starts or [self.starts[i] for i in (chosen if chosen is not None else range(len(self.starts)))]
        runs = [self.case.runs[i] for i in chosen] if chosen is not None else list(self.case.runs)
        found: list[dict[str, F64]] = [{} for _ in runs]
        for setup in dict.fromkeys(run.setup for run in runs):
            members, here = [i for i, run in enumerate(runs) if run.setup == setup], edit.of(setup)
            tracks = self._rolled_out(
                here, here.compiled(setup), [runs[i] for i in members], coarse, [begun[i] for i in members], seconds
            )
            for i, track in zip(members, tracks, strict=True):
                found[i] = track
        return found

    def _rolled_out(
        self, edit: Edit, model: MjModel, runs: Sequence[Run], coarse: int, begun: Sequence[Start], seconds: float
    ) -> list[dict[str, F64]]:
        """The same of runs that share a model."""
        spare(model)
        model.opt.timestep *= coarse
        dt = model.opt.timestep
        settle = [self._settle_steps(start, edit, dt) for start in begun]
        lengths = [int(np.ceil((min(run.duration, seconds) + 0.05) / dt)) + 2 for run in runs]
        steps = [lead + length for lead, length in zip(settle, lengths, strict=True)]
        control = [
            self._controls_of(model, run, edit, n, k, start)
            for run, n, k, start in zip(runs, steps, settle, begun, strict=True)
        ]
        off = [switched_off(self.case, model, r, edit, n, k) for r, n, k in zip(runs, steps, settle, strict=True)]
        edges = [
            [0, *self._anchored_at(start, edit, k, dt), n] for start, n, k in zip(begun, steps, settle, strict=True)
        ]
        parts = [(i, part, slice(*ends)) for i, e in enumerate(edges) for part, ends in enumerate(pairwise(e))]
        states = [initial_state(self.case, model, runs[i], edit, begun[i].part(part)) for i, part, _ in parts]
        offs = [None if (own := off[i]) is None else own[rows] for i, _, rows in parts]
        rolled = iter(self.rolled(model, states, [control[i][rows] for i, _, rows in parts], edit, offs))
        sensors = [np.concatenate([next(rolled) for _ in e[1:]]) for e in edges]
        return [tracks_of(self.context, model, s, k, edit) for s, k in zip(sensors, settle, strict=True)]

    def _controls_of(self, model: MjModel, run: Run, edit: Edit, steps: int, settle: int, start: Start) -> F64:
        s, make = edit.signals, partial(controls, self.context, model, run, edit, steps, settle, start)
        if s.actuator_lag or s.pulses or any(self.case.lags.values()):
            return make()
        of = run.name, id(start), model.nu, model.opt.timestep, steps, settle, s.command_delay, *s.joint_offset.items()
        return self._controls.get(of, lambda: (start, make()))[1]

    def rolled(
        self,
        model: MjModel,
        states: Sequence[F64],
        controls: Sequence[F64],
        edit: Edit,
        off: Sequence[Bool | None] | None = None,
    ) -> list[F64]:
        """(T, S) sensors a run, from (X,) full physics states under (T, U) controls.

        `off`: (T, U) bool a run of actuators that give no force at a step, or None where all do.
        """
        if self._end < np.inf and (stop_requested() or time.monotonic() > self._end):
            raise OutOfTime(
                "the search ended before there was an answer",
                file=self.case.folder,
                found="an interrupt" if stop_requested() else f"a time limit of {self.config.time_limit:g} minutes",
                hint="raise time_limit (--time-limit), or name the effects to consider (--effects)",
            )
        step: Roller = rolled
        if edit.signals.load_friction or edit.signals.position_torque:
            drives = {j: (edit.motor_joint(j), a) for j, a in self.context.actuator.items()}
            laws = gears(model, edit.signals.load_friction, drives)
            step = partial(stepped, laws, waves=waves(model, edit.signals.position_torque))
        jobs = list(zip(states, controls, off or [None] * len(states), strict=True))
        with self._counting:
            self.simulated_seconds += float(sum(map(len, controls))) * float(model.opt.timestep)
        with quiet_mujoco():
            return list(self.cores.each(lambda run: switched(step, model, *run), jobs))

    def _settle_steps(self, start: Start, edit: Edit, dt: float) -> int:
        """Steps before the first sample."""
        if start.moving:  # late encoders read at time 0 the state that was there earlier
            return round(edit.signals.observation_delay / dt) if start.encoders else 0
        seconds = self.config.settle_seconds
        if self.case.floating and all(r.init_qpos is not None for r in self.case.runs):
            seconds = min(
                seconds, RESTING
            )  # the logged state is the robot's own rest; contacts would creep away from it
        return round(seconds / dt)

    def _anchored_at(self, start: Start, edit: Edit, settle: int, dt: float) -> list[int]:
        """Steps at which a run goes on from a state of the log: late encoders read there what was earlier."""
        late = 0.0 if self.case.floating else edit.signals.observation_delay
        return [settle + round((anchor.time - late) / dt) for anchor in start.anchors]

    def _command_steps(self, run: Run) -> F64:
        """(T, J) what each new command adds to a position servo's torque at once, N m."""
        steps = np.zeros((len(run.time), len(self.case.joint_names)))
        for joint, name in self.context.actuator.items():
            u = self.case.actuator_names.index(name)
            change = np.diff(run.command[:, u], prepend=run.command[0, u]) * run.on[:, u]
            steps[:, self.case.joint_names.index(joint)] = self.case.command_torque(joint) * change
        return steps

    def read(self, run: Run, raw: dict[str, F64], edit: Edit) -> F64:
        """(T, C) at the time stamps of the run, through the wrappers."""
        s = edit.of(run.setup).signals
        settle, dt = raw["settle"]
        now = (run.time + settle) / dt
        late = now - s.observation_delay / dt
        columns: dict[str, F64] = {}
        names = self.case.joint_names
        shift = np.array([s.joint_offset.get(n, 0.0) + s.reading_offset.get(n, 0.0) for n in names])
        columns["joint_pos"] = sample(raw["pos"], late) + shift
        columns["joint_vel"] = sample(low_passed(raw["vel"], self.velocity_lag, float(dt)), late)
        gain = np.array([1 + s.torque_gain.get(n, 0.0) for n in names])
        columns["joint_torque"] = sample(raw["torque"], late) * gain
        if s.torque_phase:
            if run.name not in self._steps:
                self._steps[run.name] = self._command_steps(run)
            columns["joint_torque"] += s.torque_phase * self._steps[run.name]
        if "base_pos" in raw:
            columns["base_pos"] = sample(raw["base_pos"], now) + np.array(s.base_bias)
            if run.name in self._turned:
                reference, turned = self._turned[run.name]
                turn = rotation_from(sample(raw["base_quat"], now), reference)
                columns["base_rot"] = nearest_turn(turn, turned) + np.array(s.base_turn)
        if "gyro" in raw:
            then = now - s.imu_delay / dt
            columns["imu_gyro"] = sample(raw["gyro"], then) + np.array(s.gyro_bias)
            commands = (run.time + s.command_delay + settle) / dt
            before, after = either_side(raw["acc"], then, commands)
            columns["imu_acc"] = before + s.imu_phase * (after - before) + np.array(s.acc_bias)
        return np.stack([columns[c.signal][:, c.index] for c in self.channels], axis=1)


def measured(run: Run, channels: Sequence[Channel]) -> F64:
    """(T, C) of the log, orientation as a rotation vector from the first sample."""
    columns = dict(run.signals)
    if "base_quat" in columns:
        columns["base_rot"] = logged_turn(run)
    return np.stack([columns[c.signal][:, c.index] for c in channels], axis=1)


def logged_turn(run: Run) -> F64:
    """(T, 3) rotation vectors of the base from its first logged orientation, without jumps beyond half a turn."""
    quat = run.signals["base_quat"]
    return continuous_turn(rotation_from(quat, first_rows(quat)))


def _inside(raw: dict[str, F64]) -> dict[str, F64]:
    settle, dt = (float(v) for v in raw["settle"])
    return {k: raw[k][round(settle / dt) :] for k in ("pos", "vel", "torque")}
