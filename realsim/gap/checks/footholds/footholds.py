"""Which foothold is otherwise than scanned: higher, lower, tilted, softer, more slippery, wobbling, and by how much."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from realsim.core.statistics import Z90, Interval
from realsim.core.types import F64
from realsim.gap.case.case import Case
from realsim.gap.checks.camera.mixed import EVIDENCE, Fit, fit
from realsim.gap.checks.camera.terrain import Terrain
from realsim.gap.checks.footholds.touches import Touch, Touches, find_touches

# Priors. Everyday sizes are what a good scan and a good robot err by; they come from the
# contact errors of reconstructed scenes (docs/contact.md: 2 to 5 mm) and from what encoders and motion capture are off
# by, looked at on terrains 0 and 1 of tests/truths/crossings.py; benchmarks/diagnosis/footholds.py reports on others.
HEIGHT, TILT = 0.003, 0.01
"""m and rad by which any scanned top is off."""
FAR, STEEP = 0.05, 0.1
"""m and rad that a changed foothold may be off by."""
YIELD, SWAYS, GIVES = 0.002, 0.001, 0.03
"""m under the robot's weight by which firm footholds differ down and sideways, and by which a soft one gives way."""
BASE, WALK = 0.1, 0.002
"""m of the base's height that is off from the start; m by which it wanders, per root of a second."""
LEAN = 0.01
"""rad by which the base's orientation is off in a run."""
LEG = 0.004
"""m by which one leg reaches farther than the model's (encoder zeros, lengths, a worn sole)."""
KNOT = 2.0
"""s between the knots of the base's wandering height."""
SLIDES = 0.004
"""m a contact by which a slippery foothold's slip exceeds that of all others at least."""
HELD = 0.5
"""Share of the sideways over the downward load that other footholds bear, below which one must slide to be slippery."""
FINALISTS = 6
"""Candidates a round that are fitted."""
LEAST_TOUCHES = 3
LEVER = 0.02
"""m beside its middle at which a wobbling foothold is loaded, for the figure that is given."""
ONE_SIDED = ("give", "wobble")
"""A foothold cannot be firmer than rigid."""
FIRST_GUESS = (0.004, 0.002)


@dataclass(frozen=True)
class Foothold:
    """One place on the terrain where feet stood."""

    name: str
    geom: str
    place: tuple[float, float, float]
    """m, scene frame: the middle of the contacts, at the scanned top."""
    touches: int
    runs: int
    quantities: dict[str, Interval]
    """height (m), tilt_x, tilt_y (rad), give, wobble (m under the robot's weight), slip (m a contact), friction."""
    changes: tuple[str, ...] = ()
    """Which of these are beyond everyday deviations: height, tilt, give, slip, wobble; the surest first."""
    evidence: dict[str, float] = field(default_factory=dict)
    """Log-odds of each, less the penalty for having tested this many."""

    def as_dict(self) -> dict[str, Any]:
        return {
            "name": self.name, "geom": self.geom, "place": list(self.place), "touches": self.touches, "runs": self.runs,
            "changes": list(self.changes), "evidence": self.evidence,
            **{name: q.as_dict() for name, q in self.quantities.items()},
        }  # fmt: skip


@dataclass(frozen=True)
class FootholdMap:
    """All footholds of a log."""

    footholds: tuple[Foothold, ...]
    lost: int
    """Contacts where the scene has no top."""
    contacts: int
    base: tuple[float, float]
    """m: least and largest height by which the base's pose is off, over the runs' starts."""
    scatter: float
    """m: how much the heights of one foothold differ from contact to contact."""

    knots: tuple[F64, ...] = field(default=(), repr=False)
    """Run -> (K,) m by which the base's height is off, KNOT s apart from the start of the run."""
    leans: tuple[F64, ...] = field(default=(), repr=False)
    """Run -> (2,) m of height for a m along the world's x and y from the base, by a lean of its orientation."""

    def correction(self, run: int, time: float, arm: F64) -> F64:
        """(6,) m to add to a place on the robot `arm` (3,) m from its base, and rotation vector to turn it by."""
        if run >= len(self.leans):  # no foot stood in it
            return np.zeros(6)
        lean = self.leans[run]
        off = float(np.interp(time / KNOT, np.arange(len(self.knots[run])), self.knots[run]))
        return np.array([0.0, 0.0, -off - float(lean @ arm[:2]), -lean[1], lean[0], 0.0])

    @property
    def changed(self) -> tuple[Foothold, ...]:
        return tuple(h for h in self.footholds if h.changes)


def survey(case: Case, terrain: Terrain, progress: Callable[[str, float], None] | None = None) -> FootholdMap:
    """The map of a log's footholds.

    Raises:
        GapError: see `find_touches`.
    """
    tick = progress or (lambda what, share: None)
    tick("contacts", 0.1)
    touches = find_touches(case, terrain)
    tick("footholds", 0.7)
    names = sorted({t.name for t in touches.items})
    vertical, sideways = _Heights(touches, names), _Wobble(touches, names)
    accepted = vertical.search() | sideways.search()
    slips = _slips(touches, names, np.random.default_rng(0))
    found = []
    for k, name in enumerate(names):
        mine = [t for t in touches.items if t.name == name]
        quantities = vertical.quantities(k) | sideways.quantities(k) | slips[k][0]
        evidence = {kind: odds for (at, kind), odds in accepted.items() if at == k}
        if slips[k][1] > 0:
            evidence["slip"] = slips[k][1]
        middle = np.mean([np.mean(t.place, axis=0) for t in mine], axis=0) + mine[0].middle
        top = terrain.below(np.array([*middle, mine[0].top + 0.2]), 0.0)[0]
        place = (float(middle[0]), float(middle[1]), float(top))
        changes = tuple(kind for kind, _ in sorted(evidence.items(), key=lambda item: -item[1]))
        runs = len({t.run for t in mine})
        found.append(Foothold(name, terrain.name(mine[0].geom), place, len(mine), runs, quantities, changes, evidence))
    wander = vertical.wander()
    starts = [float(w[0]) for w in wander if len(w) > 1]
    return FootholdMap(
        tuple(found), touches.lost, len(touches.items) + touches.lost, (min(starts), max(starts)),
        vertical.fit.group_size, wander, vertical.leaning(),
    )  # fmt: skip


class _Search:
    """Each foothold's parameters have an everyday and a wide prior; those that must be wide are found one by one."""

    kinds: ClassVar[dict[str, tuple[int, ...]]]
    """Kind of change -> which of a foothold's parameters it moves."""
    units: ClassVar[dict[str, str]]
    """Parameter of a foothold -> its unit."""

    def __init__(self, A: F64, y: F64, group: Any, prior: F64, wide: F64, first: int, names: Sequence[str]) -> None:
        self.A, self.y, self.group, self.prior, self.wide, self.first = A, y, group, prior.copy(), wide, first
        self.names, self.per = names, len(wide)
        self.fit: Fit = fit(A, y, group, self.prior, FIRST_GUESS)

    def at(self, k: int, kind: str) -> list[int]:
        return [self.first + self.per * k + i for i in self.kinds[kind]]

    def search(self) -> dict[tuple[int, str], float]:
        """(foothold, kind) -> log-odds, of all that are beyond everyday deviations."""
        price = float(np.log(max(len(self.names) * len(self.kinds), 1)))
        found: dict[tuple[int, str], float] = {}
        while True:
            sizes = self.fit.group_size, self.fit.noise
            plain = fit(self.A, self.y, self.group, self.prior, sizes, robust=False)
            gains = {
                (k, kind): plain.bayes(self.at(k, kind), self._wide(kind))
                for k in range(len(self.names))
                for kind in self.kinds
                if (k, kind) not in found
            }
            best, odds, better = None, EVIDENCE, self.fit
            for key in sorted(gains, key=lambda key: -gains[key])[:FINALISTS]:
                # Only with the change in the model is it seen which contacts err: a fit without it distrusts its own.
                prior = self.prior.copy()
                prior[self.at(*key)] = self._wide(key[1])
                tried = fit(self.A, self.y, self.group, prior, sizes)
                gain = -tried.bayes(self.at(*key), self.prior[self.at(*key)]) - price
                if gain > odds and (key[1] not in ONE_SIDED or tried.mean[self.at(*key)[0]] > 0):
                    best, odds, better = key, gain, tried
            if best is None:
                return found
            found[best] = odds
            self.prior[self.at(*best)], self.fit = self._wide(best[1]), better

    def _wide(self, kind: str) -> F64:
        return self.wide[list(self.kinds[kind])]

    def quantities(self, k: int) -> dict[str, Interval]:
        """The parameters of one foothold."""
        found = {}
        for index, (name, unit) in enumerate(self.units.items(), self.first + self.per * k):
            mean, half = self.fit.mean[index], Z90 * np.sqrt(self.fit.covariance[index, index])
            found[name] = Interval(float(mean), float(mean - half), float(mean + half), unit)
        return found


class _Heights(_Search):
    """Heights of feet against scanned tops. The base's height, which wanders, its lean, and the legs are nuisances."""

    kinds: ClassVar = {"height": (0,), "tilt": (1, 2), "give": (3,)}
    units: ClassVar = {"height": "m", "tilt_x": "rad", "tilt_y": "rad", "give": "m"}

    def __init__(self, touches: Touches, names: Sequence[str]) -> None:
        items = touches.items
        runs, feet = 1 + max(t.run for t in items), 1 + max(t.foot for t in items)
        ends = [max((float(t.time[-1]) for t in items if t.run == r), default=None) for r in range(runs)]
        knots = [0 if end is None else 2 + int(np.ceil(end / KNOT)) for end in ends]
        self.starts = np.concatenate([[0], np.cumsum(knots)])
        lean, leg = int(self.starts[-1]), int(self.starts[-1]) + 2 * runs
        firm = leg + feet
        first = firm + 1
        width = first + 4 * len(names)
        rows, y, group = [], [], []
        for g, t in enumerate(items):
            k = names.index(t.name)
            A = np.zeros((len(t.time), width))
            # A random walk as steps: the height at a time is the sum of all steps before it, the last one in part.
            own = np.arange(knots[t.run])
            share = np.clip(t.time[:, None] / KNOT - (own - 1), 0.0, 1.0)
            share[:, 0] = 1.0
            A[:, self.starts[t.run] : self.starts[t.run + 1]] = share
            A[:, lean + 2 * t.run : lean + 2 * t.run + 2] = t.arm
            A[:, leg + t.foot] = 1.0
            load = t.load / touches.weight
            A[:, firm] = -load
            A[:, first + 4 * k] = 1.0
            A[:, first + 4 * k + 1] = t.place[:, 1]  # a turn about x lifts what lies at positive y
            A[:, first + 4 * k + 2] = -t.place[:, 0]
            A[:, first + 4 * k + 3] = -load
            rows.append(A)
            y.append(t.height)
            group.append(np.full(len(t.time), g))
        prior = np.full(width, WALK * np.sqrt(KNOT))
        prior[self.starts[:-1][np.diff(self.starts) > 0]] = BASE
        prior[lean:leg], prior[leg:firm], prior[firm] = LEAN, LEG, GIVES
        wide = np.array([FAR, STEEP, STEEP, GIVES])
        prior[first:] = np.tile([HEIGHT, TILT, TILT, YIELD], len(names))
        super().__init__(np.vstack(rows), np.concatenate(y), np.concatenate(group), prior, wide, first, names)

    def wander(self) -> tuple[F64, ...]:
        """Run -> (K,) m by which the base's height is off at its knots."""
        steps = [self.fit.mean[a:b] for a, b in zip(self.starts[:-1], self.starts[1:], strict=True)]
        return tuple(np.cumsum(s) if len(s) else np.zeros(1) for s in steps)

    def leaning(self) -> tuple[F64, ...]:
        """Run -> (2,) its lean."""
        first, runs = int(self.starts[-1]), len(self.starts) - 1
        return tuple(self.fit.mean[first + 2 * r : first + 2 * r + 2] for r in range(runs))


class _Wobble(_Search):
    """How far feet move sideways as load comes onto a place beside the middle, and come back: what stays is slip."""

    kinds: ClassVar = {"wobble": (0,)}
    units: ClassVar = {"wobble": "m"}

    def __init__(self, touches: Touches, names: Sequence[str]) -> None:
        rows, y, group = [], [], []
        count = len(names)
        for g, t in enumerate(touches.items):
            k = names.index(t.name)
            for axis in (0, 1):
                A = np.zeros((len(t.time), 2 + 2 * count))
                A[:, 0] = A[:, 2 + count + k] = t.shear[:, axis] / touches.weight
                A[:, 1] = A[:, 2 + k] = t.load / touches.weight * t.place[:, axis] / LEVER
                rows.append(A - A.mean(axis=0))
                gone = np.linspace(0.0, 1.0, len(t.time)) * (t.slid[-1, axis] - t.slid[0, axis])
                moved = t.slid[:, axis] - gone
                y.append(moved - moved.mean())
                group.append(np.full(len(t.time), 2 * g + axis))
        design, moved, groups = np.vstack(rows), np.concatenate(y), np.concatenate(group)
        # How much footholds differ anyway, by what legs and the estimated load leave, is seen from most of them.
        free = fit(design, moved, groups, np.full(design.shape[1], GIVES), FIRST_GUESS).mean[2:]
        usual = [1.4826 * float(np.median(np.abs(v - np.median(v)))) for v in (free[:count], free[count:])]
        everyday = np.repeat(np.hypot(SWAYS, usual), count)
        prior = np.concatenate([[GIVES, GIVES], everyday])
        super().__init__(design, moved, groups, prior, np.array([GIVES]), 2, names)


SLIDING = 0.02
"""m/s from which a foot slides."""


def _slips(touches: Touches, names: Sequence[str], rng: np.random.Generator) -> list[tuple[dict[str, Interval], float]]:
    """For each foothold: its slip a contact and the friction at which feet slid, and the log-odds that it is slippery.

    Feet slide a little everywhere, where a gait pushes sideways. A slippery foothold lets them slide farther than
    others (slips are positive and skewed, so logarithms are compared) although it bears less push sideways than they.
    """
    by_name = {name: [t for t in touches.items if t.name == name and len(t.time) > 2] for name in names}
    slid = {n: np.array([np.linalg.norm(t.slid[-1] - t.slid[0]) for t in items]) for n, items in by_name.items()}
    borne = {
        n: float(np.quantile(np.concatenate([_ratio(t) for t in items]), 0.9)) for n, items in by_name.items() if items
    }
    price = float(np.log(max(len(names), 1)))

    def typical(values: F64, unit: str) -> Interval:
        low, high = np.quantile(np.median(rng.choice(values, (400, len(values))), axis=1), [0.05, 0.95])
        return Interval(float(np.median(values)), float(low), float(high), unit)

    result: list[tuple[dict[str, Interval], float]] = []
    for name in names:
        mine = slid[name]
        if len(mine) < LEAST_TOUCHES:
            result.append(({}, 0.0))
            continue
        quantities = {"slip": typical(mine, "m")}
        others = np.concatenate([np.zeros(0), *(v for other, v in slid.items() if other != name)])
        usual = float(np.median([v for other, v in borne.items() if other != name] or [0.0]))
        odds = 0.0
        farther = len(others) >= LEAST_TOUCHES and quantities["slip"].low - np.median(others) > SLIDES
        if farther and borne[name] < HELD * usual:
            a, b = np.log(mine + 1e-3), np.log(others + 1e-3)
            scatter = 1.4826 * float(np.median(np.abs(b - np.median(b)))) + 1e-6
            z = (np.median(a) - np.median(b)) / (scatter * np.sqrt(np.pi / 2 * (1 / len(a) + 1 / len(b))))
            odds = float(0.5 * z * abs(z)) - price
        grip = np.concatenate([_ratio(t)[t.speed > SLIDING] for t in by_name[name]])
        if odds >= EVIDENCE and len(grip) >= LEAST_TOUCHES:
            quantities["friction"] = typical(grip, "ratio")
        result.append((quantities, odds if odds >= EVIDENCE else 0.0))
    return result


def _ratio(t: Touch) -> F64:
    """(M,) sideways over downward load; while the foot slides, the coefficient of friction."""
    return np.asarray(np.linalg.norm(t.shear, axis=1) / t.load)
