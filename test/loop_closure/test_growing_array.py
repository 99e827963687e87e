"""An array that grows row by row holds what was put into it, and leaves alone what was handed out before."""

from __future__ import annotations

import numpy as np

from loop_closure.growing_array import GrowingArray


def test_rows_are_those_that_were_added_however_often_it_had_to_grow() -> None:
    rows = np.random.default_rng(0).normal(size=(100, 3))
    growing = GrowingArray((3,))
    for row in rows:
        growing.append(row)
    np.testing.assert_array_equal(growing.rows, rows)
    assert len(growing) == 100


def test_what_was_handed_out_stays_as_it_was_and_a_copy_is_one() -> None:
    growing = GrowingArray.of(np.arange(16.0))
    before = growing.rows
    copy = GrowingArray.of(before)
    for k in range(20):
        growing.append(-k)
    copy.rows[0] = 7.0
    np.testing.assert_array_equal(before, np.arange(16.0))
    assert copy.rows[0] == 7.0


def test_new_rows_are_empty() -> None:
    growing = GrowingArray((), np.int64, -1)
    growing.reach(3)
    growing.reach(2)
    growing.reach(40)
    assert growing.rows.tolist() == [-1] * 40
