"""Every hand-set figure of the search for causes: what it is, why it has this size, and the data that it was set on.

"Generated cases" are those of the benchmark, seeds 97 to 101. "Budget" marks what bounds the work, set by the
time that a case takes: a larger value may only find more. "Not tuned": set once, never compared.
"""

from __future__ import annotations

# ---------------------------------------------------------------- the score, in nats (log-likelihood)
PRICE = 4.0
"""A parameter that the data determine: half a log of some 3,000 independent samples. Not tuned."""
CAUSE, CAUSE_A_JOINT = 3.0, 2.5
"""A cause, and the same for each joint of the robot: more joints offer more places for a cause, and a servo's
unmodelled form is worth some on every one. Set on generated cases without a gap."""
SHARED, UNUSUAL = 0.5, 4.0
"""A value that holds at several places (so that those where it does nothing are left out), and an effect that is
rarer than another one that does the same (`Effect.usual`). Not tuned."""
CLEARLY = 5.0
"""A set takes another's place only if its score is this much lower: odds of 150 to 1. Not tuned."""
SHARE = 0.08
"""Share of the misfit that a further cause must remove beside its price. No law is exact, and a wrong cause can
always bend to a little of what another one leaves. Set on generated cases with one cause."""
HOLDS, MOST_RUNS = 0.5, 0.6
"""A further cause must gain on runs left out in turn: on average by this many standard errors, and on this share of
the runs. Runs excite an effect to very different degrees. Set on generated cases."""
EQUAL, EQUAL_SHARE, DOUBTFUL = 8.0, 0.03, 4.0
"""Two sets explain the runs alike if their scores differ by less than EQUAL nats, or by less than EQUAL_SHARE of
what both remove (DOUBTFUL times that if the runs left out do not share the preference). Set on generated look-
alikes."""
CERTAIN = 0.975
"""Quantile of Student's t that a preference on runs left out must exceed to tell two sets apart. Conventional."""
GATE_MEDIAN, GATE_MEAN = 1.4, 2.8
"""Mean squares over the noise floor (the median run's, all runs') above which nuisance parameters do not explain a
log. Set on generated cases without a gap; a single run near a resonance may exceed both."""
REASONABLE = 3.0
"""Prior standard deviations that a nuisance parameter may take. Conventional."""
NAMED_SHARE = 1 / 3
"""Share of the squared error of the check that causes must remove to be named beside a rest; the search ends where no
set can come to it. A cause that changes the motion by as much as the model is wrong by anyway removes about half. Set
on the development logs of real robots: right causes removed 40 and 46 % or nearly all, wrong ones 1, 15 and 18 %."""

# ---------------------------------------------------------------- the search
EXPANSIONS, RUNNERS_UP, RUNNER_SHARE = 8, 2, 0.25
"""Sets whose neighbours are looked at; those of them in a row that may be no better than the best set; and the share
of the gap that such a set must remove, of what the best removes. Budget."""
NEAR, NEAR_SHARE = 20.0, 0.15
"""Nats, and share of what the best removes, within which a fit can still catch up with the best by fitting further.
Budget."""
WORTH, WORTH_SHARE, FINALISTS, MORE = 10.0, 0.04, 5, 4
"""Candidates of the linear screen that are fitted: those above WORTH nats and this share of the leader, FINALISTS of
them, then the best place of up to MORE further effects. Budget."""
ALONE, MOST_ALONE = 0.3, 2
"""Share of the misfit that an effect must explain without any nuisance parameter to be fitted whatever the screen
says, and how many such effects are fitted. Beside a large gap the screen may share a cause out among many nuisance
parameters. Budget."""
ALIKE, MOST_ALIKE = 0.95, 3
"""Squared cosine above which two sensitivities count as the same, and rivals of this kind that are fitted.
Budget."""
FORETOLD, SMALL = 0.2, 3.0
"""Slopes are believed where the best candidate removes this share of the misfit by them, or where less than SMALL
times the floor stays. Else candidates are simulated. Set on generated quadrupeds."""
PROBED, PROBED_FEET, KEPT, KEPT_FEET, STANDS_OUT = 60, 12, 5, 3, 2.5
"""Candidates that are simulated, those of them that move the ground or a foot or whose nuisance parameter is
STANDS_OUT standard deviations off, and those that are then fitted. Budget."""
SIZES, ABRUPT_SIZES, BENT_SIZES = (1.5, -1.5), (2.0, 0.7, -0.7, -2.0), (0.5, 1.5)
"""Sizes at which they are simulated, in steps of the parameter: of any effect, of one that shows nothing below a
threshold, of one whose nuisance parameter already points the way. Not tuned."""
NEIGHBOURS = (0.65, 0.8, 0.9, 1.1, 1.25, 1.5)
"""Factors on a cause's strength from which a fit begins anew where feet slip and land: the misfit is jagged there.
Set on generated quadrupeds."""

# ---------------------------------------------------------------- forces that act for a while
GRID, LEAD, SHORTEST = 0.1, 0.2, 0.2
"""Seconds: of the grid on which windows begin and end at first, before an onset at which one may begin, of the
shortest. Not tuned."""
MARGIN, TIMES = 20.0, 1.5
"""Nats, and factor, by which a window must explain more than the same force throughout. Not tuned."""
SLIDES = (0.3, 0.1, 0.03)
"""Steps in which the edges of a window are moved (s) and its force changed (share). Budget."""

# ---------------------------------------------------------------- fits
WIDE, NARROWER, NARROWEST = 0.1, 0.2, 0.01
"""Share of a step over which slopes are taken; factor on it where a promising step gains nothing; the least share.
Wide differences see through sticking friction; a payload's mass and place on a pendulum need narrow ones."""
PACES, PROMISED, POLISH = 6.0, 1.0, 2
"""A fit ends where this many more steps as good as the last would not reach its target; nats that a step must
promise for slopes to be taken again; steps with the model's own time step after a fit with a coarser one. Budget."""
SETTLED, SWITCHED, LIKELIER = 0.6, 0.5, 40.0
"""Share of the weighted squares that nuisance parameters may leave to be simulated and not only linear; the same for
the other friction cone, which has no slope; nats that it must bring beside causes. Set on generated quadrupeds."""
SHARPEST = 0.3
"""Least factor on the allowed discrepancy once a cause explains the gap: a second, smaller one would go under in it.
Set on generated cases with two causes."""
TOO_LONG = 25
"""Driven joints, times how much finer a law makes the time step, from which on slopes are taken at the nominal model
only. Budget: of G1 they take as long as all the rest."""
LEVER, SHIFT = 0.3, 0.03
"""Metres off a body's centre of mass within which a payload is looked for, and that it may shift that centre. Not
tuned."""
