"""The parkour task as a vector environment: one definition for every engine and ray caster."""

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from torch import Tensor

from trainer.errors import TrainerError
from trainer.graphs import Graph, places, room
from trainer.physics import Physics, State
from trainer.rays import RayCaster
from trainer.tasks.base import Observation, Step
from trainer.tasks.parkour.body import Body
from trainer.tasks.parkour.commands import GoalCommand
from trainer.tasks.parkour.config import ParkourConfig
from trainer.tasks.parkour.curriculum import Curriculum
from trainer.tasks.parkour.depth import DepthCamera, DepthWindow
from trainer.tasks.parkour.draw import Dice, randint
from trainer.tasks.parkour.footholds import FootholdProbe
from trainer.tasks.parkour.observations import HeightScan, Proprioception, Transitions, critic_view, layout
from trainer.tasks.parkour.randomise import Known, Line, Randomiser
from trainer.tasks.parkour.resets import Course, Stances, poses
from trainer.tasks.parkour.rewards import SLOW, WALKING, Rewards
from trainer.tasks.parkour.signals import PhaseClock, Signals, derive, sole_points
from trainer.tasks.parkour.symmetry import Mirror
from trainer.tasks.parkour.tally import Tally
from trainer.tasks.parkour.terminations import DIVERGED, RUNNING, SUCCESS, TIMEOUT, Clocks, judge


@dataclass(frozen=True)
class Ends:
    """Episodes that ended at a step; rows belong to `ids`."""

    ids: Tensor
    """(K,) worlds."""
    outcome: Tensor
    """(K,) index into `terminations.OUTCOMES`."""
    position: Tensor
    """(K, 3) m, where the base was."""
    seconds: Tensor
    """(K,)."""
    covered: Tensor
    """(K,) share of the way."""
    terrain: Tensor
    """(K,) index of the terrain."""


@dataclass
class _Moment:
    """What the task makes of a policy step, before worlds that ended start anew; rows are worlds."""

    observation: Observation
    reward: Tensor
    amp: Tensor | None
    outcome: Tensor
    trial: Tensor
    """(N,) outcome of what counts as a trial."""
    covered: Tensor
    way: Tensor
    """(N,) the same share for the curriculum."""
    terminated: Tensor
    truncated: Tensor
    ended: Tensor
    """() how many worlds did."""


class ParkourEnv:
    """A batch of worlds; a `trainer.tasks.VecEnv`. Build it with `trainer.tasks.parkour.make`.

    A step has four parts: `_before` the engine's step, that, `_after` it, and `_again` for worlds that ended. With
    `graphs` each is a CUDA graph. All that lives from one step to the next stays where it is, and `step` waits for the
    device once, to learn how many worlds have ended.
    """

    def __init__(
        self,
        physics: Physics,
        caster: RayCaster,
        edges: Sequence[np.ndarray],
        config: ParkourConfig,
        *,
        rows: int = 1,
        variants: int = 1,
        known: Known | None = None,
        seed: int = 0,
        graphs: bool = False,
    ) -> None:
        """A task over an engine.

        Args:
            physics: the worlds; its terrains are ordered row by row of the curriculum grid, and the `variants` of each
                in a row.
            caster: rays over the same terrains.
            edges: for each terrain (E, 2, 3) feature edges, metres.
            rows: rows of the curriculum grid; 1 for terrains without an order.
            known: what a gap diagnosis knows about the robot.
            seed: of all draws.
            graphs: make steps CUDA graphs, if the device is one for them; see `Step`.
        """
        self.physics, self.config, self.variants = physics, config, variants
        self.device, self.num_worlds, self.policy_dt = physics.device, physics.num_worlds, physics.policy_dt
        robot, worlds, device = physics.robot, physics.num_worlds, physics.device
        self.body = Body.of(robot, device)
        self.num_actions = len(robot.joints)
        self.max_steps = round(config.termination.seconds / physics.policy_dt)
        if self.max_steps < 1:
            raise TrainerError(
                "an episode is shorter than a policy step",
                expected=f"termination.seconds of at least {physics.policy_dt:g}",
                found=f"{config.termination.seconds:g}",
            )
        self.generator = Dice(device)
        self.generator.manual_seed(seed)
        self.course = Course.of(physics.terrains, device)
        kinds, by_failure = len(physics.terrains) // variants, config.reset.by_failure
        self.curriculum = Curriculum(kinds, rows, worlds, device, self.generator, by_failure, config.reset.keep_last)
        self.command = GoalCommand(config.command, worlds, device)
        self.randomiser = Randomiser(config.randomisation, known or Known(), physics)
        self.probe = FootholdProbe(physics.terrains, edges, caster, self.body, config.reward.edge_radius)
        self.proprioception = Proprioception(config.observation, self.num_actions, worlds, device)
        self.camera, self.images = self._eyes(caster)
        self.rewards = Rewards(config.reward, self.body, physics.policy_dt, device)
        self.transitions = Transitions(worlds, self.num_actions, len(robot.feet), device) if config.amp else None
        self.phase = PhaseClock(worlds, len(robot.feet), physics.policy_dt, device)
        self.tally = Tally(self.rewards.names, [t.family for t in physics.terrains], worlds, device)
        self.stances = self._stances(caster, seed) if config.reset.along > 0 else None
        self.scan = None
        if config.observation.scan and self.images is not None:
            self.scan = HeightScan(caster, robot.standing_height, device)
        self.mirror = Mirror(robot, config.observation.history, device, scan=self.scan is not None)
        depth = None if self.images is None else (config.depth.frames, *self.images.ring.shape[2:])
        self.layout = layout(robot, config.observation, depth, config.depth.stride)
        self.terrain_ids = torch.zeros(worlds, dtype=torch.long, device=device)
        self.age = torch.zeros(worlds, dtype=torch.long, device=device)
        self.shortened = torch.zeros(worlds, dtype=torch.bool, device=device)
        """(N,) whether the episode began at a later age than 0: running out of time says nothing then."""
        self.elsewhere = torch.zeros(worlds, dtype=torch.bool, device=device)
        """(N,) whether the episode began on the course: how far it came says nothing then."""
        self.origin = torch.zeros(worlds, 2, device=device)
        self.at_start = torch.zeros(worlds, device=device)
        self.on_goal = torch.zeros(worlds, device=device)
        self.last_action = torch.zeros(worlds, self.num_actions, device=device)
        self.misread = torch.zeros(worlds, self.num_actions, device=device) if self.randomiser.misread else None
        """(N, J) rad that the servos read too much; None where they read right."""
        self.line = Line(self.randomiser.latest, worlds, self.num_actions, device) if self.randomiser.latest else None
        """Commands on their way; None where they are late by a policy step at most, which the engine simulates."""
        self.count = 0
        self.clock = torch.zeros((), dtype=torch.long, device=device)
        """() the same, as the device knows it."""
        self.ends: Ends | None = None
        """Episodes that ended at the last step; None if none did."""
        self.graphs = graphs and torch.device(device).type == "cuda"
        self.padded = self.graphs
        """Whether batches have one of a few sizes, instead of as many rows as are needed."""
        self._actions = torch.zeros_like(self.last_action)
        self._final = self.layout.zeros(worlds, device)
        self._acting = Graph(self._before, self.generator, self.graphs)
        self._looking = Graph(self._after, self.generator, self.graphs)
        self._restarting = Graph(self._again, self.generator, self.graphs)

    # ------------------------------------------------------------ the two methods of a VecEnv

    def reset(self) -> Observation:
        """Start all worlds anew; with `spread_ages` as if at random times of their episodes."""
        everyone = torch.arange(self.num_worlds, device=self.device)
        signals = self._restart(everyone)
        if self.config.reset.spread_ages:
            self.age.copy_(randint(0, self.max_steps, self.num_worlds, self.generator))
            torch.gt(self.age, 0, out=self.shortened)
        return Observation(self.proprioception.read(), self._critic_view(signals), self._window())

    def step(self, actions: Tensor) -> Step:
        """One policy step with actions (N, J): joint targets are default + scale * action."""
        self._actions.copy_(actions)
        self.physics.step(self._acting(pushes=self.randomiser.pushes(None if self.padded else self.count)))
        self.count += 1
        now = self._looking()
        observation, ended = now.observation, int(now.ended)  # the one wait for the device
        self.ends = None
        if ended:
            rows = room(ended, self.num_worlds) if self.padded else ended
            observation, ends = self._restarting(now, rows=rows)
            self.ends = Ends(*(getattr(ends, f.name)[:ended] for f in fields(Ends)))
        final = self._final if ended else None
        return Step(observation, now.reward, now.terminated, now.truncated, final, now.amp, self._log(), ended)

    def state_dict(self) -> dict[str, Any]:
        """Curriculum and random generator."""
        return {
            "curriculum": self.curriculum.state_dict(),
            "generator": self.generator.get_state(),
            "count": self.count,
        }

    def load_state_dict(self, state: dict[str, Any], seed: int | None = None) -> None:
        """Continue from `state_dict`; call `reset` next.

        Args:
            seed: draw anew from this one instead of going on where the saved random numbers ended.

        Raises:
            TrainerError: the curriculum was of another grid of terrains. It is as it was; the rest goes on.
        """
        if seed is None:
            self.generator.set_state(state["generator"].cpu())
        else:
            self.generator.manual_seed(seed)
        self.count = int(state["count"])
        self.clock.fill_(self.count)
        self.curriculum.load_state_dict(state["curriculum"])

    def ease(self) -> None:
        """See `VecEnv.ease`: worlds go back by a row, and waiting costs twice what it did."""
        self.curriculum.ease()
        self.rewards.scale("dont_wait", 2.0)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What makes the figures of this environment doubtful so far; for reports."""
        found = [f"{effect}: diagnosed, but not simulated by this task" for effect in self.randomiser.known.unused]
        if self.physics.overflowed:
            found.append(
                f"{self.physics.overflowed} contacts or constraints dropped: a buffer of the engine is too small"
            )
        if self.tally.diverged:
            found.append(f"{self.tally.diverged} worlds diverged and were reset")
        return tuple(found)

    # ------------------------------------------------------------ parts of a step

    def _before(self, pushes: int) -> Tensor:
        """(N, J) joint targets for the engine, after this step's pushes."""
        self._actions.clamp_(-self.config.action_limit, self.config.action_limit)
        if pushes:
            self.randomiser.push(self.clock, pushes, self.generator)
        targets = self.body.default + self.body.action_scale * self._actions
        if self.misread is not None:
            targets = targets - self.misread
        return targets if self.line is None else self.line(targets)

    def _after(self) -> _Moment:
        """Rewards, ends and observations in the engine's state."""
        state = self.physics.state
        self.clock += 1
        self.age += 1
        signals = self._signals(state)
        outcome = self._judge(signals)
        reward, terms = self.rewards(signals)
        observation = self._observe(signals)
        self.last_action.copy_(self._actions)
        amp = None if self.transitions is None else self.transitions.advance(signals, self.body)
        covered = self.course.covered(state.base_pos[:, :2].nan_to_num(), self.terrain_ids)
        # What counts as a trial: from the start platform, in full time.
        no_trial = (self.shortened & (outcome == TIMEOUT)) | (self.elsewhere & (outcome > DIVERGED))
        trial = outcome.masked_fill(no_trial, RUNNING)
        waiting = (signals.command.speed > WALKING) & (signals.heading_vel[:, 0] < SLOW)
        self.tally.add(terms, trial, covered, self.age * self.policy_dt, self.terrain_ids, waiting)
        self.curriculum.count(trial > DIVERGED, trial == SUCCESS)
        way = covered.masked_fill(no_trial, 1.0)  # what was no trial leaves its world in its row
        over = outcome != RUNNING
        terminated, truncated = over & (outcome < TIMEOUT), outcome >= TIMEOUT
        return _Moment(observation, reward, amp, outcome, trial, covered, way, terminated, truncated, over.sum())

    def _again(self, now: _Moment, rows: int) -> tuple[Observation, Ends]:
        """New episodes where some ended: (N) observations with theirs, and (rows) of the ends.

        With more rows than ends the last world that ended takes part several times, with the same draws: it is written
        several times what it is written once, and no other world is touched.
        """
        ids, which = places(now.outcome != RUNNING, rows)
        ends = self._ends(ids, now.outcome, now.covered)
        for final, newest in zip(self._final.tensors(), now.observation.tensors(), strict=True):
            final[ids] = newest[ids]
        with self.generator.repeated(which) if self.padded else nullcontext():
            self.curriculum.update(ids, now.trial[ids] == SUCCESS, now.way[ids], self.generator)
            signals = self._restart(ids)
        new = Observation(self.proprioception.read(ids), self._critic_view(signals, ids), self._window(ids))
        for old, first in zip(now.observation.tensors(), new.tensors(), strict=True):
            old[ids] = first
        return now.observation, ends

    def _signals(self, state: State) -> Signals:
        contact = state.foot_force > self.config.reward.contact_force
        phase = self.phase.advance(contact)
        footholds = self.probe(state, self.terrain_ids)
        return derive(state, self.command(state), footholds, contact, phase, self._actions, self.last_action)

    def _judge(self, s: Signals) -> Tensor:
        dt, near = self.policy_dt, self.config.termination.stuck_radius
        here = s.state.base_pos[:, :2]
        nearby = (here - self.origin).norm(dim=-1) < near
        self.at_start.add_(dt).mul_(nearby)
        arrived = self.course.on_goal(here, s.state.foot_pos[..., :2], self.terrain_ids)
        self.on_goal.add_(dt).mul_(arrived)
        fails, floor = (of_terrain[self.terrain_ids] for of_terrain in (self.course.ground_fails, self.course.floor_z))
        clocks = Clocks(self.at_start, self.on_goal, fails, floor, self.command.limit > 0)
        return judge(s, clocks, self.age, self.max_steps, self.body, self.config.termination)

    def _observe(self, s: Signals) -> Observation:
        self.proprioception.push(s, self.body, self.generator)
        if self.camera is not None and self.images is not None:
            self.images.push(self.camera.render(s.state, self.terrain_ids, None, self.generator))
        return Observation(self.proprioception.read(), self._critic_view(s), self._window())

    def _restart(self, ids: Tensor) -> Signals:
        """New episodes in worlds `ids` (K,); the signals of their first moment (K rows)."""
        terrain = self.curriculum.terrain(ids) * self.variants
        terrain = terrain + randint(0, self.variants, len(ids), self.generator)
        self.terrain_ids[ids] = terrain
        drawn = self.randomiser.reset(ids, self.generator) if self.randomiser.active else None
        if drawn is not None:
            self.proprioception.encoder_offset[ids], self.proprioception.gyro_offset[ids] = drawn.encoder, drawn.gyro
            if self.misread is not None:
                self.misread[ids] = drawn.servo
        position, quaternion, joints, self.elsewhere[ids] = poses(
            terrain, self.course, self.body, self.config.reset, self.generator, self.stances
        )
        self.physics.reset(ids, position, quaternion, joints, terrain)
        if self.line is not None and drawn is not None:
            self.line.reset(ids, joints, drawn.late)
        self.command.reset(ids, self.course.goal[terrain, :2], self.generator)
        self.phase.reset(ids)
        for clock in (self.last_action, self.age, self.at_start, self.on_goal):
            clock.index_fill_(0, ids, 0)
        self.shortened.index_fill_(0, ids, False)
        self.origin[ids] = position[:, :2]
        return self._first_look(ids)

    def _first_look(self, ids: Tensor) -> Signals:
        everything = self.physics.state
        state = State(**{f.name: getattr(everything, f.name)[ids] for f in fields(State)})
        command = self.command(everything).rows(ids)
        footholds = self.probe(state, self.terrain_ids[ids])
        contact, phase, still = self.phase.contact[ids], self.phase.time[ids], self.last_action[ids]
        signals = derive(state, command, footholds, contact, phase, still, still)
        self.proprioception.restart(ids, signals, self.body, self.generator)
        if self.camera is not None and self.images is not None:
            self.camera.reset(ids, self.generator)
            first = self.camera.render(everything, self.terrain_ids, ids, self.generator)
            self.images.restart(ids, first, self.generator)
        if self.transitions is not None:
            self.transitions.restart(ids, signals, self.body)
        return signals

    def _critic_view(self, s: Signals, ids: Tensor | None = None) -> Tensor:
        terrain_ids = self.terrain_ids if ids is None else self.terrain_ids[ids]
        scan = None if self.scan is None else self.scan(s.state, terrain_ids)
        return critic_view(s, self.body, self.config.observation.steered, scan)

    def _window(self, ids: Tensor | None = None) -> Tensor | None:
        return None if self.images is None else self.images.window(ids)

    def _ends(self, ids: Tensor, outcome: Tensor, covered: Tensor) -> Ends:
        where = self.physics.state.base_pos[ids].clone()
        return Ends(ids, outcome[ids], where, self.age[ids] * self.policy_dt, covered[ids], self.terrain_ids[ids])

    def _log(self) -> dict[str, float]:
        if self.count % self.config.log_every:
            return {}
        counters = {
            "physics/overflowed": float(self.physics.overflowed),
            "physics/solver_limited": float(self.physics.solver_limited),
        }
        return self.tally.report(self.curriculum.row, self.terrain_ids, counters, self.config.divergence_limit)

    def _stances(self, caster: RayCaster, seed: int) -> Stances:
        """Where on each course a robot can be put; the engine holds it in its default pose before the first reset."""
        state = self.physics.state
        points, _ = sole_points(state, self.body)
        soles = points[0] - state.base_pos[0] * torch.tensor([1.0, 1.0, 0.0], device=self.device)
        return Stances.find(self.course, soles, caster, seed)

    def _eyes(self, caster: RayCaster) -> tuple[DepthCamera | None, DepthWindow | None]:
        mount, config = self.physics.robot.camera, self.config.depth
        if not config.use:
            return None, None
        if mount is None:
            raise TrainerError(
                f"{self.physics.robot.robot.name} has no depth camera", hint="switch depth images off, or another robot"
            )
        camera = DepthCamera(mount, config, caster, self.num_worlds, self.device)
        return camera, DepthWindow(config, (camera.height, camera.width), self.num_worlds, self.device)
