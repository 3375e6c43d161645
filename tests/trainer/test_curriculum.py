"""The grid: up after success, down after little progress, and every row stays alive."""

import pytest
import torch

from trainer.errors import TrainerError
from trainer.tasks.parkour.curriculum import Curriculum


def grid(worlds=400, rows=10, columns=20, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return Curriculum(rows * columns, rows, worlds, torch.device("cpu"), generator), generator


def test_worlds_are_spread_over_columns_and_begin_in_the_easy_half():
    c, _ = grid()
    assert torch.equal(c.column.bincount(), torch.full((20,), 20))
    assert c.row.max() == 4
    ids = torch.arange(400)
    assert torch.equal(c.terrain(ids), c.row * 20 + c.column)


def test_promotion_and_demotion():
    c, generator = grid(5)
    c.row[:] = torch.tensor([3, 3, 3, 0, 9])
    success = torch.tensor([True, False, False, False, True])
    covered = torch.tensor([1.0, 0.7, 0.2, 0.1, 1.0])
    c.update(torch.arange(5), success, covered, generator)
    assert c.row[:4].tolist() == [4, 3, 2, 0]
    assert 0 <= c.row[4] <= 9  # the last row is mastered: anywhere


def test_only_the_worlds_that_ended_move():
    c, generator = grid(6)
    before = c.row.clone()
    c.update(torch.tensor([1, 4]), torch.tensor([True, True]), torch.ones(2), generator)
    moved = (c.row != before).nonzero().squeeze(-1).tolist()
    assert moved == [1, 4]


def test_masters_of_the_last_row_are_sent_everywhere():
    c, generator = grid(1000)
    c.row[:] = 9
    c.update(torch.arange(1000), torch.ones(1000, dtype=torch.bool), torch.ones(1000), generator)
    assert set(c.row.tolist()) == set(range(10))


def test_a_saved_curriculum_fits_another_number_of_worlds():
    c, _ = grid(64)  # not a multiple of the 20 columns: counted on, worlds would get rows of another column
    c.row[:] = c.column % 10
    saved = c.state_dict()
    fewer, more = grid(30, seed=1)[0], grid(150, seed=1)[0]
    for other in (fewer, more):
        other.load_state_dict(saved)
        assert torch.equal(other.row, other.column % 10)
    with pytest.raises(TrainerError, match="another grid"):
        grid(8, rows=5)[0].load_state_dict(saved)


def test_a_grid_that_is_not_full_is_refused():
    with pytest.raises(TrainerError, match="do not fill"):
        Curriculum(7, 2, 4, torch.device("cpu"), torch.Generator())


def drawn_by_failure(share=0.5, worlds=4000, columns=4):
    generator = torch.Generator().manual_seed(0)
    return Curriculum(columns, 1, worlds, torch.device("cpu"), generator, share), generator


def test_terrains_that_are_failed_come_more_often():
    c, generator = drawn_by_failure()
    everyone, tried = torch.arange(4000), torch.ones(4000, dtype=torch.bool)
    for _ in range(3000):  # the third terrain is never crossed, the others always
        c.count(tried, c.column != 2)
    assert c.chances().tolist() == pytest.approx([0.125, 0.125, 0.625, 0.125], abs=1e-3)
    c.update(everyone, tried, torch.ones(4000), generator)
    found = c.column.bincount(minlength=4) / 4000
    assert found.tolist() == pytest.approx([0.125, 0.125, 0.625, 0.125], abs=0.03)
    assert c.terrain(everyone).max() == 3


def test_what_was_no_trial_says_nothing_of_a_terrain():
    c, _ = drawn_by_failure()
    c.count(torch.zeros(4000, dtype=torch.bool), torch.zeros(4000, dtype=torch.bool))
    assert c.chances().tolist() == pytest.approx([0.25] * 4)


def test_failures_of_long_ago_are_forgotten():
    c, _ = drawn_by_failure()
    tried = torch.ones(4000, dtype=torch.bool)
    for crossed in (c.column != 0, c.column != 1):
        for _ in range(3000):
            c.count(tried, crossed)
    assert c.chances().argmax() == 1


def test_a_graded_grid_keeps_its_columns():
    generator = torch.Generator().manual_seed(0)
    c = Curriculum(40, 10, 400, torch.device("cpu"), generator, 0.5)
    before = c.column.clone()
    c.update(torch.arange(400), torch.zeros(400, dtype=torch.bool), torch.zeros(400), generator)
    assert torch.equal(c.column, before)


def test_one_terrain_alone_takes_no_draw():
    generator = torch.Generator().manual_seed(0)
    c = Curriculum(1, 1, 8, torch.device("cpu"), generator, 0.5)
    c.count(torch.ones(8, dtype=torch.bool), torch.zeros(8, dtype=torch.bool))
    assert set(c.state_dict()) == {"row", "rows", "columns"}
    plain = torch.Generator().manual_seed(0)
    Curriculum(1, 1, 8, torch.device("cpu"), plain)
    for which, dice in ((c, generator), (Curriculum(1, 1, 8, torch.device("cpu"), torch.Generator()), plain)):
        which.update(torch.arange(8), torch.zeros(8, dtype=torch.bool), torch.zeros(8), dice)
    assert torch.equal(generator.get_state(), plain.get_state())


def test_how_often_terrains_are_failed_is_resumed():
    c, _ = drawn_by_failure()
    c.count(torch.ones(4000, dtype=torch.bool), c.column != 2)
    other = drawn_by_failure(worlds=7)[0]
    other.load_state_dict(c.state_dict())
    assert torch.equal(other.chances(), c.chances())
    plain = Curriculum(4, 1, 7, torch.device("cpu"), torch.Generator())
    plain.load_state_dict(c.state_dict())
    other.load_state_dict(plain.state_dict())  # saved without: what is known stays
    assert torch.equal(other.chances(), c.chances())


def test_where_nothing_fails_all_come_alike():
    c, _ = drawn_by_failure(worlds=40)
    c.failed.zero_()
    assert c.chances().tolist() == pytest.approx([0.25] * 4)
