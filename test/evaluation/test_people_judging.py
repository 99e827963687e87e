"""Who has to be known to the people tracker, and when."""

from __future__ import annotations

import numpy as np

from evaluation.experiments.people_judging import Expected


def test_expected_are_those_in_view_for_long_until_hidden_for_long_and_then_anew() -> None:
    expected = Expected(2)
    told = []
    for k in range(120):
        stamp = 0.1 * k
        # The first is in view for 3 s, hidden for 5 s, and back; the second shows two returns, too few, all the time.
        in_view = stamp < 3.0 or stamp >= 8.0
        told.append(expected.look(np.array([9 * in_view, 2]), stamp, 0.1))
    first, second = np.array(told).T
    assert not second.any()
    changes = 0.1 * (np.flatnonzero(np.diff(first.astype(int))) + 1)
    np.testing.assert_allclose(changes, [1.4, 5.9, 9.4], atol=0.11)
