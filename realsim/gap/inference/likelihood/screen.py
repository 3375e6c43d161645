"""Every effect at every place at once: sensitivities by simulation, then linear algebra.

The residual r of the nominal simulator is taken as r = G x + e: G holds one column an atom (effect, place, parameter),
x is small for the deviations that every robot has (prior sizes from the effects) and large for a cause. Everything the
selection needs is in A = G'WG, b = G'Wr, c = r'Wr of each run.
"""

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import zip_longest
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F32, F64
from realsim.gap import figures
from realsim.gap.case.model.context import like_joints
from realsim.gap.effects import EFFECTS, ON_REQUEST
from realsim.gap.effects.base import Effect, Parameter, Place
from realsim.gap.effects.lookup import SINCE, lookup
from realsim.gap.effects.nuisances import NUISANCES
from realsim.gap.inference.likelihood.comparison import Comparison, Conditions, Weights
from realsim.gap.inference.likelihood.linear import Evidence, Spectrum, scaled
from realsim.gap.simulation.cores import Recent
from realsim.gap.simulation.simulate import OutOfTime, Setting, Simulator

SLIDING = {"N m": "N", "N m s/rad": "N s/m", "kg m^2": "kg", "rad": "m", "rad/s": "m/s"}
"""Unit of a parameter at a joint that turns -> at one that slides."""

Key = tuple[str, Place, tuple[str, ...]]
"""Of a candidate: effect, all its joints or bodies, names of its parameters."""


@dataclass(frozen=True)
class Atom:
    """One column: a parameter of an effect at one place."""

    effect: str
    place: Place
    parameter: Parameter


@dataclass(frozen=True)
class Candidate:
    """A possible cause: an effect at one or several places that share parameters."""

    effect: str
    places: tuple[Place, ...]
    parameters: tuple[Parameter, ...]
    """Those that are fitted."""
    directions: F64
    """(p, m) columns over atoms: what one unit of each parameter does, to first order."""
    linear: tuple[str, ...]
    """The m parameters that have a direction (others act only at second order)."""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters)

    @property
    def place(self) -> Place:
        """All joints or bodies."""
        return tuple(n for p in self.places for n in p)

    @property
    def key(self) -> Key:
        return self.effect, self.place, self.names

    def settings(self, values: dict[str, float]) -> list[Setting]:
        """What the simulator is told: places of a group share the values."""
        places = (self.place,) if lookup(self.effect).law.joint_figure else self.places
        return [(self.effect, place, values) for place in places]


@dataclass(frozen=True)
class _Point:
    """Where slopes are taken."""

    settings: tuple[Setting, ...]
    onsets: Mapping[str, float]
    runs: tuple[int, ...]
    """Positions among the screened runs."""
    base: list[F64]
    """(T, C) a run: the prediction there at coarse steps."""
    fine: list[F64]
    """The same at the model's own steps."""


class Screen:
    """Atoms, their columns on the chosen runs, and the candidates made of them."""

    def __init__(
        self,
        simulator: Simulator,
        comparison: Comparison,
        runs: Sequence[int],
        effects: Sequence[str] = (),
        tick: Callable[[str, float], None] = lambda what, share: None,
        since: bool = False,
    ) -> None:
        """`since`: candidates are changes that the later one of two logs has; each may come and go in small, too."""
        self.simulator, self.comparison, self.runs = simulator, comparison, list(runs)
        self.skipped: dict[str, str] = {}
        self._version = -1
        """Of the weights and slopes that the normal matrices are made of."""
        self._by: Weights | None = None
        self._seen_beside: dict[bool, frozenset[tuple[str, Place]]] = dict.fromkeys((True, False), frozenset())
        """Whether of everyday deviations -> (effect, place) of the causes that move the robot otherwise, about which
        slopes were taken last."""
        self._about: Recent[list[F32] | None] = Recent(4)
        """Columns with slopes about causes, those of the set before the present one too."""
        self._informed: Recent[tuple[F64, Spectrum]] = Recent(8)
        """Information on the atoms, which all predictions share that are looked at under the same weights."""
        self._fitted: Recent[tuple[F32, F32]] = Recent(32)
        """Columns, and what small deviations change by them: all predictions beside the same ones share it."""
        self.ranked: Recent[Any] = Recent(1)
        """A set, and its candidates by the evidence that they add: several proposals look at the same."""
        self._lock = threading.Lock()
        """Held where the normal matrices are made anew."""
        self._A: list[F64] = []
        self._weighted: list[F64] = []
        context = simulator.context
        chosen = [n for n in EFFECTS if (n in effects if effects else n not in ON_REQUEST)]
        names = [*chosen, *NUISANCES]
        names += [n + SINCE for n in names] if since else []
        chosen = [n + SINCE for n in chosen] if since else chosen
        wanted: list[Atom] = []
        borrowed: set[tuple[str, Place]] = set()
        """Of effects whose slopes are all those of others."""
        for effect in map(lookup, names):
            places = effect.places(context)
            if not places:
                self.skipped[effect.name] = (
                    effect.excited_by(context, ()).reason if effect.scope == "global" else "no place"
                )
            for place in places:
                excitation = effect.excited_by(context, place)
                if not excitation.yes:
                    self.skipped.setdefault(effect.name, excitation.reason)
                    continue
                # Shape parameters (a Stribeck velocity, where a payload sits) do nothing on their own.
                slopes = [
                    Atom(effect.name, place, p)
                    for p in effect.parameters(context, place)
                    if p.strength and not (p.like and p.like[0] in names)
                ]
                borrowed |= set() if slopes else {(effect.name, place)}
                wanted += slopes
        self.nominal = simulator.simulate(runs=self.runs)
        # Slopes of a large robot bear a coarser step: it halves the time, and both ends of the difference share it.
        self.coarse = 2 if simulator.case.model.nv >= 5 and context.timestep <= 0.0025 else 1
        self.trees: dict[str, int] = {}
        """Joint or body -> its kinematic tree, where none of them feels another one."""
        self.cut_short = False
        """Whether time was over before there were slopes: then there are no atoms, and no candidates."""
        changes: list[list[F32] | None] = []
        try:
            base = simulator.simulate(runs=self.runs, coarse=self.coarse)
            if not all(np.isfinite(y).all() for y in base):  # stiff servos may not bear it
                self.coarse, base = 1, simulator.simulate(runs=self.runs)
            point = _Point((), {}, tuple(range(len(self.runs))), base, self.nominal)
            self.trees = self._apart(wanted, point)
            changes = self._slopes(wanted, point, lambda share: tick("sensitivities", share))
        except OutOfTime:
            self.cut_short = True
        felt = [(atom, change) for atom, change in zip(wanted, changes, strict=False) if change is not None]
        self.atoms = [atom for atom, _ in felt]
        sizes = [len(comparison.times[run]) * len(comparison.channels) for run in self.runs]
        self._columns = [np.zeros((size, len(felt)), np.float32) for size in sizes]
        for i, (_, change) in enumerate(felt):
            for column, changed in zip(self._columns, change, strict=True):
                column[:, i] = changed
        if not (self.atoms or self.cut_short):
            raise GapError(
                "nothing that the log could show changes the simulation",
                file=simulator.case.folder,
                hint="are the commands in the unit that log.json says, and do they move the joints?",
            )
        self.crowded = simulator.context.touches or len(simulator.case.joint_names) >= figures.MANY_JOINTS
        """Whether everyday deviations are so many that a cause can hide among them."""
        seconds, model = sum(simulator.case.runs[i].duration for i in self.runs), simulator.case.model
        self.slow = self.crowded or seconds / simulator.context.timestep * model.nv > figures.WORK
        """Whether the runs take long to simulate."""
        self.index = {(a.effect, a.place, a.parameter.name): i for i, a in enumerate(self.atoms)}
        self.varied = self._varied()
        self.prior = np.array([a.parameter.nuisance for a in self.atoms])
        self.usual = np.array([a.parameter.usual for a in self.atoms])
        """(p,) what the small deviations may scatter about instead of zero."""
        self.stiff = np.array([lookup(a.effect).law.stiff for a in self.atoms], bool)
        """(p,) True for atoms that no time step bears at the size of a deviation: a spring would have to be softer."""
        slow = [lookup(a.effect).law.stepwise or a.parameter.fine for a in self.atoms]
        self.simulable = ~(self.stiff | np.array(slow, bool))
        """(p,) False for atoms that cost steps one by one, or many of them: as nuisances they stay linear."""
        self.candidates = self._candidates(chosen, borrowed)
        self.effects = {c.effect for c in self.candidates}

    def _varied(self, count: int = 3) -> tuple[int, ...] | None:
        """Positions of a few screened runs from calm to lively, for the searches of rivals where simulating takes long;
        None where it does not, or where there are fewer: then coarse steps did not settle friction beside weak motors.
        """
        if len(self.runs) < count or not self.slow:
            return None
        commands = [self.simulator.case.runs[r].command for r in self.runs]
        order = np.argsort([float(np.abs(np.diff(c, axis=0)).sum() / len(c)) for c in commands])
        few = np.linspace(0, len(order) - 1, count)
        return tuple(int(order[i]) for i in few.round().astype(int))

    def relinearise(self, settings: Sequence[Setting], conditions: Conditions, further: bool = True) -> None:
        """Take all slopes anew about these causes: a robot that moves otherwise answers otherwise.

        Those of the causes themselves stay. What does next to nothing there, or cannot be simulated, explains nothing.
        A cause that only the sensors have leaves every slope as it was. Unless a `further` cause is looked for, only
        those of everyday deviations are taken, which tell whether one is.
        """
        moving = frozenset(
            (name, place) for name, place, values in settings if self.simulator.moves((name, place, values))
        )
        for everyday in (True, False) if further else (True,):
            if moving == self._seen_beside[everyday]:
                continue
            which = np.flatnonzero((self.prior > 0) == everyday).tolist()
            # The search often comes back to a set, with values that differ a little.
            columns = self._about.get((moving, everyday), partial(self._taken_about, settings, conditions, which))
            if columns is None:
                continue
            self._columns = [c.copy() for c in self._columns]
            for own, taken in zip(self._columns, columns, strict=True):
                own[:, which] = taken
            self._seen_beside[everyday], self._by = moving, None

    def _taken_about(self, settings: Sequence[Setting], conditions: Conditions, which: list[int]) -> list[F32] | None:
        """The columns of these atoms with slopes about these causes; None if they cannot be simulated."""
        simulate, onsets = self.simulator.simulate, conditions.onsets
        there = simulate(settings, self.runs, onsets=onsets)
        base = simulate(settings, self.runs, self.coarse, onsets) if self.coarse > 1 else there
        if not all(np.isfinite(y).all() for y in (*there, *base)):
            return None
        found = [c.copy() for c in self._columns]
        near = {self._tree(place) for _, place, _ in settings}
        others = [
            i
            for i, atom in ((i, self.atoms[i]) for i in which)
            if not any(atom.effect == name and set(atom.place) <= set(place) for name, place, _ in settings)
            and (None in near or self._tree(atom.place) in {None, *near})
        ]
        every = tuple(range(len(self.runs)))
        # Where simulating takes long, the liveliest run tells which slopes are as they were.
        first = every if self.varied is None else self.varied[-1:]
        for runs in (first, tuple(k for k in every if k not in first)):
            point = _Point(tuple(settings), onsets, runs, [base[k] for k in runs], [there[k] for k in runs])
            changes = self._slopes([self.atoms[i] for i in others], point) if runs else []
            for i, change in zip(others, changes, strict=False):
                for n, k in enumerate(runs):
                    found[k][:, i] = change[n] if change else 0.0
            weights = conditions.weights
            others = [i for i in others if any(self._turned(k, i, found[k][:, i], weights) for k in runs)]
        return [c[:, which] for c in found]

    def _turned(self, k: int, i: int, slope: F32, weights: Weights) -> bool:
        """Whether the slope of an atom on screened run k is another one than before."""
        root, old = np.sqrt(weights.of[self.runs[k]].reshape(-1)), self._columns[k][:, i]
        return bool(np.linalg.norm(root * (slope - old)) > figures.TURNED * np.linalg.norm(root * old))

    def _slopes(
        self, atoms: Sequence[Atom], point: _Point, tick: Callable[[float], None] = lambda share: None
    ) -> list[list[F32] | None]:
        """Change of the prediction by one unit of each atom, a flat (B * C) array a run; None of what cannot run."""
        columns: list[list[F32] | None] = [None] * len(atoms)
        together = self._together(atoms)
        found = self.simulator.cores.each(
            lambda which: self._column_of_each([atoms[i] for i in which], point), together
        )
        for k, (which, those) in enumerate(zip(together, found, strict=True)):
            tick(k / len(together))
            for i, column in zip(which, those, strict=True):
                columns[i] = column
        return columns

    def _together(self, atoms: Sequence[Atom]) -> list[list[int]]:
        """Positions of atoms that are simulated at once: one of each of the trees that do not feel one another, as
        groups of columns of a Jacobian that share no row (Curtis, Powell and Reid, J. Inst. Maths Applics 13, 1974)."""
        alone: list[list[int]] = []
        by_tree: dict[tuple[bool, int], list[int]] = {}
        for i, atom in enumerate(atoms):
            tree = self._tree(atom.place)
            if tree is None:
                alone.append([i])
            else:
                by_tree.setdefault((_at_own_step(atom), tree), []).append(i)
        for fine in (False, True):
            trees = [members for (own, _), members in by_tree.items() if own == fine]
            alone += [[i for i in row if i is not None] for row in zip_longest(*trees)]
        return alone

    def _tree(self, place: Place) -> int | None:
        """Kinematic tree that a place lies in, where it feels no other one; None elsewhere."""
        return next(iter(found)) if len(found := {self.trees.get(name) for name in place}) == 1 else None

    def _apart(self, wanted: Sequence[Atom], point: _Point) -> dict[str, int]:
        """Joint or body -> its kinematic tree, on a robot on a stand whose legs and arms do not feel one another: what
        changes in one leaves the readings of the others as they were. Empty on other robots."""
        case, model = self.simulator.case, self.simulator.case.model
        labels = [c.label for c in self.comparison.channels]
        if case.floating or model.ntree < 2 or not set(labels) <= set(case.joint_names):
            return {}
        trees = {model.joint(j).name: int(model.dof_treeid[model.jnt_dofadr[j]]) for j in range(model.njnt)}
        trees |= {
            model.body(b).name: int(model.body_treeid[b]) for b in range(model.nbody) if model.body_treeid[b] >= 0
        }
        trees.pop("", None)
        tree_of = np.array([trees[label] for label in labels])
        for tree in set(trees.values()):
            first = next((a for a in wanted if {trees.get(name) for name in a.place} == {tree}), None)
            change = self._changed([first], 1.0, point) if first else None
            if change is None or any(
                np.abs(c / self.comparison.noise.detail)[:, tree_of != tree].max(initial=0) > 1e-6 for c in change
            ):
                return {}
        return trees

    def _column_of_each(self, atoms: Sequence[Atom], point: _Point) -> list[list[F32] | None]:
        """Columns of atoms of trees that do not feel one another."""
        change = self._changed(atoms, 1.0, point) if len(atoms) > 1 else None
        if change is None:
            return [self._column(atom, point) for atom in atoms]
        labels = [c.label for c in self.comparison.channels]
        found = []
        for atom in atoms:
            own = np.array([self.trees[label] == self._tree(atom.place) for label in labels])
            found.append(self._seen(atom, [np.where(own, c, 0.0) / _width(atom) for c in change]))
        return found

    def _column(self, atom: Atom, point: _Point) -> list[F32] | None:
        for scale in (1.0, -1.0, 0.3):  # a payload may only be removable, a gap only be small
            change = self._changed([atom], scale, point)
            if change is not None:
                return self._seen(atom, [c / (scale * _width(atom)) for c in change])
        return None

    def _changed(self, atoms: Sequence[Atom], scale: float, point: _Point) -> list[F64] | None:
        """(B, C) a run: change of the prediction by so much of their width of these atoms together; None if it is out
        of their range or cannot run."""
        moves: list[Setting] = []
        for atom in atoms:
            p = atom.parameter
            value = p.default + scale * _width(atom)
            if not p.bounds[0] <= value <= p.bounds[1]:
                return None
            moves.append((atom.effect, atom.place, {p.name: value}))
        coarse, base = (1, point.fine) if _at_own_step(atoms[0]) else (self.coarse, point.base)
        runs = [self.runs[k] for k in point.runs]
        try:
            moved = self.simulator.simulate([*point.settings, *moves], runs, coarse, point.onsets)
        except GapError:
            return None
        if not all(np.isfinite(m).all() for m in moved):
            return None
        return [self.comparison.change(run, m, y) for run, m, y in zip(runs, moved, base, strict=True)]

    def _seen(self, atom: Atom, change: list[F64]) -> list[F32] | None:
        """The column of an atom; None where it is far below what could ever be seen."""
        step, detail = atom.parameter.step, self.comparison.noise.detail
        size = max(float(np.abs(c * step / detail).max(initial=0)) for c in change)
        return [c.reshape(-1).astype(np.float32) for c in change] if size >= 0.05 else None

    def evidence(
        self, simulated: Sequence[F64], conditions: Conditions, few: tuple[int, ...] | None = None
    ) -> Evidence:
        """Normal equations of the residual about these predictions: one a screened run (or one of the `few`).

        Small deviations count from their centre also where they are in the predictions already; from the likelier one
        where there are two.
        """
        weights = conditions.weights
        with self._lock:
            if self._by is not weights:
                self._weigh(weights)
        b, c = [], []
        which = range(len(self.runs)) if few is None else few
        for k, y in zip(which, simulated, strict=True):
            run, GW = self.runs[k], self._weighted[k]
            r = self.residual(k, y, -conditions.about)
            W = np.where(np.isfinite(r), weights.of[run], 0.0)
            r = np.nan_to_num(r)
            b.append(r.reshape(-1) @ GW)
            c.append(float((W * r * r).sum()))
        A = self._A if few is None else [self._A[k] for k in few]
        found = Evidence(A, b, c, self._version, tuple(which))
        sides = self.centred(found)
        return min(sides, key=lambda e: self.misfit(e, self.prior)[0]) if len(sides) > 1 else found

    def _weigh(self, weights: Weights) -> None:
        """The atoms' normal matrices under these weights."""
        self._by, self._version = weights, self._version + 1
        self._A, self._weighted = [], []
        for run, G in zip(self.runs, self._columns, strict=True):
            W = weights.of[run].reshape(-1, 1)
            self._weighted.append(G * W)
            self._A.append((G.T @ self._weighted[-1].astype(np.float32)).astype(float))

    def centred(self, evidence: Evidence) -> list[Evidence]:
        """The evidence about each centre that the small deviations may have, its own first."""
        if not self.usual.any():
            return [evidence]
        return [evidence, evidence.moved(self.usual - 2 * np.asarray(evidence.centre))]

    def residual(self, k: int, simulated: F64, x: F64 | float = 0.0) -> F64:
        """(B, C) residual of screened run k, once small deviations x are added."""
        r = self.comparison.residual(self.runs[k], simulated)
        return r - self.fitted(k, np.asarray(x)) if np.any(x) else r

    def misfit(self, evidence: Evidence, prior: F64) -> tuple[float, float]:
        """(half the weighted squared residual beside the most probable nuisances, and their price; the scale of their
        `prior` that is the most probable)."""

        def made() -> tuple[F64, Spectrum]:
            A = np.sum(evidence.A, axis=0)
            return A, Spectrum.of(A, prior)

        key = evidence.version, evidence.runs, prior.tobytes()
        A, spectrum = made() if evidence.version < 0 else self._informed.get(key, made)
        return scaled(A, np.sum(evidence.b, axis=0), sum(evidence.c), prior, spectrum)

    def fitted(self, k: int, x: F64) -> F32:
        """(B, C) change of the prediction of screened run k by atoms x."""
        columns, by = self._columns[k], x.astype(np.float32)
        change = self._fitted.get((id(columns), by.tobytes()), lambda: (columns, columns @ by))[1]
        return change.reshape(-1, len(self.comparison.channels))

    def weighted(self, k: int) -> F64:
        """(B * C, p) of all atoms on screened run k, times the weights of the last evidence."""
        return self._weighted[k]

    def possible(self, x: F64) -> F64:
        """The nearest small deviations that can be simulated; tiny ones are left out."""
        low, high = np.array([a.parameter.bounds for a in self.atoms]).reshape(-1, 2).T
        whole = np.array([a.parameter.whole for a in self.atoms])
        x = np.where(self.simulable & (np.abs(x) > 0.05 * self.prior), x, 0.0)
        return np.asarray(np.clip(np.where(whole, np.round(x), x), low, high))

    def settings(self, x: F64) -> list[Setting]:
        """Atoms with these coordinates (0: left out) as settings for the simulator."""
        values: dict[tuple[str, Place], dict[str, float]] = {}
        for i in np.flatnonzero(x):
            atom, v = self.atoms[i], float(x[i])
            low, high = atom.parameter.bounds
            values.setdefault((atom.effect, atom.place), {})[atom.parameter.name] = min(max(v, low), high)
        return [(name, place, named) for (name, place), named in values.items()]

    def columns(self, k: int, index: Sequence[int]) -> F32:
        """(B * C, m) of some atoms on screened run k."""
        return self._columns[k][:, list(index)]

    def atoms_of(self, candidate: Candidate) -> list[int]:
        """The atoms that are this cause, and those that do the same."""
        own = [(candidate.effect, p.name) for p in candidate.parameters]
        alike = [p.like for p in candidate.parameters if p.like]
        keys = [(effect, place, name) for effect, name in own + alike for place in candidate.places]
        return [self.index[k] for k in keys if k in self.index]

    # ------------------------------------------------------------ candidates

    def _candidates(self, chosen: Sequence[str], borrowed: set[tuple[str, Place]]) -> list[Candidate]:
        found, felt = [], {(a.effect, a.place) for a in self.atoms} | borrowed
        context = self.simulator.context
        for name in chosen:
            effect = lookup(name)
            places = [p for p in effect.places(context) if (name, p) in felt]
            groups: list[tuple[Place, ...]] = [(p,) for p in places]
            if effect.scope == "joint" and len(places) > 1:
                for slides in (False, True):  # no value in N m is one in N
                    sort = [p[0] for p in places if context.case.slides(p[0]) is slides]
                    groups += [tuple((j,) for j in g) for g in like_joints(sort)]
            elif effect.scope == "terrain" and len(places) > 1:
                groups.append(tuple(places))
            for group in groups:
                for variant in effect.variants:
                    made = self._candidate(effect, group, variant)
                    if made is not None:
                        found.append(made)
        return found

    def _candidate(self, effect: Effect, group: tuple[Place, ...], variant: tuple[str, ...]) -> Candidate | None:
        every = {
            p.name: p for p in effect.parameters(self.simulator.context, tuple(n for place in group for n in place))
        }
        parameters = tuple(every[name] for name in variant or every)
        if effect.scope == "joint" and self.simulator.case.slides(group[0][0]):
            parameters = tuple(replace(p, unit=SLIDING.get(p.unit, p.unit)) for p in parameters)
        directions, linear = [], []
        for p in parameters:
            column = np.zeros(len(self.atoms))
            column[self.atoms_of(Candidate(effect.name, group, (p,), column, ()))] = 1.0
            if column.any():
                directions.append(column)
                linear.append(p.name)
        if not directions:
            return None
        # A planar arm cannot feel a force across its plane: that is no parameter of its log.
        felt = tuple(p for p in parameters if p.name in linear or not p.strength or p.like)
        return Candidate(effect.name, group, felt, np.stack(directions, axis=1), tuple(linear))


def _width(atom: Atom) -> float:
    """Over which a slope is taken: where small deviations are everyday, the slope at the nominal model counts, since it
    must predict them."""
    p = atom.parameter
    near = p.nuisance and p.bounds[0] < 0
    return float(np.copysign(min(3 * p.nuisance, abs(p.step)), p.step)) if near else p.step


def _at_own_step(atom: Atom) -> bool:
    """A stiff law that a finer step bears may blow up at the coarser one, and would then never be a candidate."""
    return atom.parameter.fine or lookup(atom.effect).law.stiff


def slab(candidate: Candidate) -> F64:
    """(m,) prior size of a cause's parameters: the step that is worth calling a gap, generously."""
    fitted = [p for p in candidate.parameters if p.name in candidate.linear]
    return np.array([0.1 * figures.LEVER if p.shape else 2.0 * abs(p.step) for p in fitted])
