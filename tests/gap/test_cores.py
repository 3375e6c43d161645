"""Simulations on several cores: the same answers in the same order, on one core or on more."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from realsim.gap import load_case
from realsim.gap.inference.causes.fit import Cause
from realsim.gap.simulation.cores import Cores

from .searching import CONFIG, fitting, logged
from .truth import Truth

EFFECTS = ("motor_gain", "armature", "load_friction", "backlash")


@pytest.mark.parametrize("threads", [1, 3])
def test_answers_come_in_the_items_order(threads: int) -> None:
    cores, met = Cores(threads), threading.Barrier(threads)

    def late(i: int) -> int:
        if i < threads:
            met.wait(240)  # all threads are at work at once
        return i * i

    assert list(cores.each(late, range(7))) == [i * i for i in range(7)]
    cores.close()
    assert list(cores.each(abs, [-1, -2])) == [1, 2]


def test_work_within_work_does_not_wait_for_a_core_that_is_taken() -> None:
    cores = Cores(2)
    found = list(cores.each(lambda i: sum(cores.each(lambda k: i * k, range(5))), range(6)))
    assert found == [10 * i for i in range(6)]
    cores.close()


def test_a_failure_is_the_caller_s() -> None:
    cores = Cores(2)
    with pytest.raises(ZeroDivisionError):
        list(cores.each(lambda i: 1 // i, [2, 1, 0, 1]))
    assert list(cores.each(lambda i: 1 // i, [1, 1])) == [1, 1]
    cores.close()


def test_two_cores_find_what_one_does(made) -> None:
    nominal = load_case(made(Truth(), runs=3))
    case = logged(nominal, [("motor_gain", ("elbow",), {"ratio": -0.2})])
    found = []
    for threads in (1, 2):
        with fitting(case, EFFECTS, config=replace(CONFIG, threads=threads)) as fitter:
            screen = fitter.screen
            cause = next(c for c in screen.candidates if (c.effect, c.place) == ("motor_gain", ("elbow",)))
            fit = fitter.fit([Cause(cause, (-0.05,))], starts=[[-0.3], [0.1]])
            assert fit is not None
            screen.relinearise(fit.settings(), fit.conditions)
            columns = [screen.columns(k, range(len(screen.atoms))) for k in range(len(case.runs))]
            found.append((fit.causes[0].values, fit.misfit, columns))
    assert found[0][:2] == found[1][:2]
    for one, two in zip(found[0][2], found[1][2], strict=True):
        np.testing.assert_array_equal(one, two)
