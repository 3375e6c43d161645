"""The parkour task as a vector environment: one definition for every engine and ray caster."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from torch import Tensor

from trainer.errors import TrainerError
from trainer.physics import Physics, State
from trainer.rays import RayCaster
from trainer.tasks.base import Observation, Step
from trainer.tasks.parkour.amp import Transitions
from trainer.tasks.parkour.body import Body
from trainer.tasks.parkour.commands import GoalCommand
from trainer.tasks.parkour.config import ParkourConfig
from trainer.tasks.parkour.curriculum import Curriculum
from trainer.tasks.parkour.depth import DepthCamera, DepthWindow
from trainer.tasks.parkour.floor import RaisedFloor
from trainer.tasks.parkour.footholds import FootholdProbe
from trainer.tasks.parkour.line import Line
from trainer.tasks.parkour.observations import Proprioception, critic_view, layout
from trainer.tasks.parkour.randomise import Known, Randomiser
from trainer.tasks.parkour.resets import Course, Stances, poses
from trainer.tasks.parkour.rewards import Rewards
from trainer.tasks.parkour.scan import HeightScan
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


class ParkourEnv:
    """A batch of worlds; a `trainer.tasks.VecEnv`. Build it with `trainer.tasks.parkour.make`.

    `step` waits for the device once, to learn which worlds have ended.
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
        self.generator = torch.Generator(device=device)
        self.generator.manual_seed(seed)
        self.course = Course.of(physics.terrains, device)
        self.curriculum = Curriculum(len(physics.terrains) // variants, rows, worlds, device, self.generator)
        self.command = GoalCommand(config.command, worlds, device)
        self.randomiser = Randomiser(config.randomisation, known or Known(), physics)
        self.probe = FootholdProbe(physics.terrains, edges, caster, self.body, config.reward.edge_radius)
        self.proprioception = Proprioception(config.observation, self.num_actions, worlds, device)
        self.camera, self.images = self._eyes(caster)
        self.rewards = Rewards(config.reward, self.body, physics.policy_dt, device)
        self.transitions = Transitions(worlds, self.num_actions, len(robot.feet), device) if config.amp else None
        self.phase = PhaseClock(worlds, len(robot.feet), physics.policy_dt, device)
        self.tally = Tally(self.rewards.names, [t.family for t in physics.terrains], worlds, device)
        self.floor = RaisedFloor(config.floor, physics.terrains, worlds, device)
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
        self.ends: Ends | None = None
        """Episodes that ended at the last step; None if none did."""

    # ------------------------------------------------------------ the two methods of a VecEnv

    def reset(self) -> Observation:
        """Start all worlds anew; with `spread_ages` as if at random times of their episodes."""
        everyone = torch.arange(self.num_worlds, device=self.device)
        signals = self._restart(everyone)
        if self.config.reset.spread_ages:
            self.age = torch.randint(
                0, self.max_steps, (self.num_worlds,), generator=self.generator, device=self.device
            )
            self.shortened = self.age > 0
        return Observation(self.proprioception.read(), self._critic_view(signals), self._window())

    def step(self, actions: Tensor) -> Step:
        """One policy step with actions (N, J): joint targets are default + scale * action."""
        action = actions.clamp(-self.config.action_limit, self.config.action_limit)
        if self.randomiser.active:
            self.randomiser.push(self.count, self.generator)
        targets = self.body.default + self.body.action_scale * action
        if self.misread is not None:
            targets = targets - self.misread
        state = self.physics.step(targets if self.line is None else self.line(targets))
        self.count += 1
        self.age = self.age + 1
        signals = self._signals(state, action)
        outcome = self._judge(signals)
        reward, terms = self.rewards(signals)
        self.last_action = action
        observation = self._observe(signals)
        amp = None if self.transitions is None else self.transitions.advance(signals, self.body)
        covered = self.course.covered(state.base_pos[:, :2].nan_to_num(), self.terrain_ids)
        # What counts as a trial: from the start platform, in full time, without help from a raised floor.
        no_trial = (self.shortened & (outcome == TIMEOUT)) | (self.elsewhere & (outcome > DIVERGED))
        helped = self.floor.touched & (outcome == SUCCESS)
        trial = outcome.masked_fill(helped, TIMEOUT).masked_fill(no_trial, RUNNING)
        self.tally.add(terms, trial, covered, self.age * self.policy_dt, self.terrain_ids)
        terminated = (outcome != RUNNING) & (outcome < TIMEOUT)
        truncated = outcome >= TIMEOUT
        final, self.ends = None, None
        ids = outcome.nonzero().squeeze(-1)  # the one wait for the device
        if len(ids):
            final = observation
            self.ends = self._ends(ids, outcome, covered)
            way = covered.masked_fill(no_trial, 1.0)[ids]  # what was no trial leaves its world in its row
            self.curriculum.update(ids, trial[ids] == SUCCESS, way, self.generator)
            observation = self._replaced(observation, ids, self._restart(ids))
        return Step(observation, reward, terminated, truncated, final, amp, self._log())

    def state_dict(self) -> dict[str, Any]:
        """Curriculum and random generator."""
        return {
            "curriculum": self.curriculum.state_dict(),
            "generator": self.generator.get_state(),
            "count": self.count,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`; call `reset` next."""
        self.curriculum.load_state_dict(state["curriculum"])
        self.generator.set_state(state["generator"].cpu())
        self.count = int(state["count"])

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

    def _signals(self, state: State, action: Tensor) -> Signals:
        contact = state.foot_force > self.config.reward.contact_force
        phase = self.phase.advance(contact)
        footholds = self.probe(state, self.terrain_ids)
        signals = derive(state, self.command(state), footholds, contact, phase, action, self.last_action)
        signals.floor_touched = self.floor.touch(state.ground_contact)
        return signals

    def _judge(self, s: Signals) -> Tensor:
        dt, near = self.policy_dt, self.config.termination.stuck_radius
        here = s.state.base_pos[:, :2]
        nearby = (here - self.origin).norm(dim=-1) < near
        self.at_start = torch.where(nearby, self.at_start + dt, torch.zeros_like(self.at_start))
        arrived = self.course.on_goal(here, s.state.foot_pos[..., :2], self.terrain_ids)
        self.on_goal = torch.where(arrived, self.on_goal + dt, torch.zeros_like(self.on_goal))
        fails = self.course.ground_fails[self.terrain_ids] & ~self.floor.raised
        clocks = Clocks(self.at_start, self.on_goal, fails, self.floor.height, self.command.limit > 0)
        return judge(s, clocks, self.age, self.max_steps, self.body, self.config.termination)

    def _observe(self, s: Signals) -> Observation:
        self.proprioception.push(s, self.body, self.generator)
        if self.camera is not None and self.images is not None:
            self.images.push(self.camera.render(s.state, self.terrain_ids, None, self.generator))
        return Observation(self.proprioception.read(), self._critic_view(s), self._window())

    def _restart(self, ids: Tensor) -> Signals:
        """New episodes in worlds `ids` (K,); the signals of their first moment (K rows)."""
        terrain = self.curriculum.terrain(ids) * self.variants
        terrain = terrain + torch.randint(0, self.variants, (len(ids),), generator=self.generator, device=self.device)
        self.terrain_ids[ids] = terrain
        drawn = self.randomiser.reset(ids, self.generator) if self.randomiser.active else None
        if drawn is not None:
            self.proprioception.encoder_offset[ids], self.proprioception.gyro_offset[ids] = drawn.encoder, drawn.gyro
            if self.misread is not None:
                self.misread[ids] = drawn.servo
        position, quaternion, joints, self.elsewhere[ids] = poses(
            terrain, self.course, self.body, self.config.reset, self.generator, self.stances
        )
        floor = self.floor.reset(ids, terrain, self.count * self.policy_dt, self.generator)
        own = floor if self.config.floor.share > 0 else None
        self.physics.reset(ids, position, quaternion, joints, terrain, own)
        if self.line is not None and drawn is not None:
            self.line.reset(ids, joints, drawn.late)
        self.command.reset(ids, self.course.goal[terrain, :2], self.generator)
        self.phase.reset(ids)
        self.last_action = self.last_action.index_fill(0, ids, 0.0)  # a copy: it may be the caller's tensor
        for clock in (self.age, self.at_start, self.on_goal):
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

    def _replaced(self, o: Observation, ids: Tensor, signals: Signals) -> Observation:
        """`o` with the rows of worlds `ids` of their new episodes; `o` itself stays what it was."""
        actor = o.actor.index_copy(0, ids, self.proprioception.read(ids))
        critic = o.critic.index_copy(0, ids, self._critic_view(signals, ids))
        depth = None if o.depth is None else o.depth.index_copy(0, ids, self._window(ids))  # type: ignore[arg-type]
        return Observation(actor, critic, depth)

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
        return Stances.find(self.course, soles, caster, self.floor.real, seed)

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
