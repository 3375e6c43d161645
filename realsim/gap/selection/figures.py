"""Every hand-set figure of the selection, with its reason and the data that it was set on."""

from __future__ import annotations

BAND_EDGES_HZ = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Octaves: model error falls with frequency, and its size is estimated in each band. Not tuned."""
DISCREPANCY_SECONDS = 0.2
"""Correlation time of model error before any data has spoken. Of the former engine, not tuned."""
IRLS_ROUNDS = 8
"""Reweightings of a residual at most; they end earlier where one gains less than 0.01 nats. A budget."""
SLAB_STEPS = 2.0
"""Prior scale of a cause in its effect's `step`, the size worth calling a gap. Of the former engine, not tuned."""
SHAPE_STEPS = 5.0
"""The same of values that say when or where, not how much. Not tuned."""
LEVER_M = 0.05
"""Metres from a body's centre of mass at which what it carries may sit: prior scale. Not tuned."""
OCCAM_WINDOW = 12.0
"""Nats behind the best set beyond which a set is neither expanded nor counted: odds of 1 to 160,000 (Madigan and
Raftery, 1994, use 1 to 20 for averaging; the search needs more, since a set may still grow)."""
PROPOSED = 5
"""Proposals that are fitted to all runs for every set that is expanded, and of one kind: a budget."""
EXPANSIONS = 6
"""Sets whose neighbours are looked at: a budget."""
ITERATIONS = 4
"""Gauss-Newton steps a fit: a budget."""
PACE = 6.0
"""A fit is broken off where this many more steps as good as the last would not bring it into Occam's window."""
ROUNDS = 4
"""Turns of Gauss-Newton steps and of taking slopes anew about the most probable deviations: a budget."""
CERTAIN = 0.8
"""Probability from which on a cause is called identified. Not tuned."""
CREDIBLE, MOST_SETS = 0.95, 4
"""Probability that the sets of an ambiguous answer hold together, and how many are printed at most."""
EXPLAINED = 4.0
"""Mean square in units of the floor up to which an unseen run counts as explained: twice the floor's size.
Not tuned."""
HELD_SHARE = 0.5
"""Share of an unseen run's squared error that a cause must remove to be named beside an unexplained rest. Not
tuned."""
LINEARISATIONS = 2
"""Times that slopes are taken anew about the best set, after which the search goes on: a budget. Case 101_001 of the
development seed needs one: on slopes of the nominal model its only cause leaves 230 nats, and a second is invented."""
