"""`k_best` against enumeration of every assignment."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from estimation.errors import InputError
from estimation.filters.assignment import k_best


def enumerate_assignments(costs):
    """Every assignment of most pairs as (cost, columns), cheapest first."""
    n, m = costs.shape
    found = []
    for columns in itertools.product(range(-1, m), repeat=n):
        pairs = [(i, j) for i, j in enumerate(columns) if j >= 0]
        if len({j for _, j in pairs}) == len(pairs) and all(np.isfinite(costs[p]) for p in pairs):
            found.append((len(pairs), sum(costs[p] for p in pairs), columns))
    most = max(entry[0] for entry in found)
    return sorted((cost, columns) for count, cost, columns in found if count == most)


@given(st.data())
@settings(max_examples=300)
def test_every_assignment_in_order(data):
    n, m = data.draw(st.integers(1, 4)), data.draw(st.integers(1, 4))
    # Few different values make ties, inf makes forbidden pairs and rows without any column.
    values = st.sampled_from([-2.0, -1.0, 0.0, 0.5, 1.0, 3.25, np.inf])
    costs = np.array(data.draw(st.lists(values, min_size=n * m, max_size=n * m))).reshape(n, m)
    expected = enumerate_assignments(costs)
    k = data.draw(st.integers(1, len(expected) + 2))
    found = k_best(costs, k)
    assert len(found) == min(k, len(expected))
    np.testing.assert_allclose([cost for cost, _ in found], [cost for cost, _ in expected[:k]])
    seen = {tuple(columns.tolist()) for _, columns in found}
    assert len(seen) == len(found)
    assert seen <= {columns for _, columns in expected}


@pytest.mark.parametrize("shape", [(7, 7), (5, 9), (9, 5)])
def test_hundred_best_of_random_costs(shape):
    rng = np.random.default_rng(3)
    costs = rng.normal(size=shape)
    wide = costs if shape[0] <= shape[1] else costs.T
    rows = np.arange(wide.shape[0])
    columns = np.array(list(itertools.permutations(range(wide.shape[1]), wide.shape[0])))
    expected = np.sort(wide[rows, columns].sum(1))[:100]
    np.testing.assert_allclose([cost for cost, _ in k_best(costs, 100)], expected)


def test_the_first_is_scipys():
    rng = np.random.default_rng(4)
    for shape in ((20, 20), (10, 60), (60, 10)):
        costs = rng.exponential(size=shape)
        cost, columns = k_best(costs, 1)[0]
        assert cost == pytest.approx(costs[linear_sum_assignment(costs)].sum())
        assert (columns >= 0).sum() == min(shape)


def test_unassigned_rows_are_minus_one():
    costs = np.array([[1.0, np.inf], [2.0, np.inf], [np.inf, np.inf]])
    assert [(cost, columns.tolist()) for cost, columns in k_best(costs, 5)] == [
        (1.0, [0, -1, -1]),
        (2.0, [-1, 0, -1]),
    ]


@pytest.mark.parametrize("offset", [1e-3, 1e6, -1e6])
def test_a_common_offset_changes_no_order(offset):
    costs = np.random.default_rng(5).random((5, 5))
    plain, shifted = k_best(costs, 40), k_best(costs + offset, 40)
    assert [c.tolist() for _, c in plain] == [c.tolist() for _, c in shifted]


def test_nothing_to_assign():
    for shape in ((0, 3), (3, 0), (0, 0)):
        ((cost, columns),) = k_best(np.zeros(shape), 3)
        assert cost == 0
        assert columns.tolist() == [-1] * shape[0]
    ((cost, columns),) = k_best(np.full((2, 2), np.inf), 3)
    assert (cost, columns.tolist()) == (0.0, [-1, -1])


def test_input_is_left_alone_and_results_repeat():
    costs = np.ones((6, 6))
    first, second = k_best(costs, 30), k_best(costs, 30)
    assert (costs == 1).all()
    assert [c.tolist() for _, c in first] == [c.tolist() for _, c in second]


@pytest.mark.parametrize(
    ("costs", "k", "name"),
    [
        ([[np.nan]], 1, "costs"),
        ([[-np.inf]], 1, "costs"),
        ([1.0, 2.0], 1, "costs"),
        ([["x"]], 1, "costs"),
        ([[1.0]], 0, "k"),
        ([[1.0]], 1.5, "k"),
    ],
)
def test_bad_input_is_named(costs, k, name):
    with pytest.raises(InputError, match=rf"^{name} must"):
        k_best(costs, k)
