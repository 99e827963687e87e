"""Values by stamp, against a sorted list searched from the front."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from estimation.geometry.history import StampedHistory

stamps = st.lists(st.integers(0, 1000), max_size=40)


@given(stamps, st.integers(-10, 1010))
def test_neighbours_of_a_stamp(arrivals: list[int], query: int) -> None:
    history: StampedHistory[int] = StampedHistory(10_000)
    for stamp in arrivals:
        history.insert(stamp, 7 * stamp)
    known = sorted(set(arrivals))
    assert len(history) == len(known)
    found = history.around(query)
    if not known or query < known[0] or query > known[-1]:
        assert found is None
        return
    before, after = max(s for s in known if s <= query), min(s for s in known if s >= query)
    share = 0.0 if before == after else (query - before) / (after - before)
    assert found == (7 * before, 7 * after, share)


@given(stamps, st.integers(1, 500))
def test_only_the_newest_are_kept(arrivals: list[int], length: int) -> None:
    history: StampedHistory[int] = StampedHistory(length)
    for stamp in arrivals:
        history.insert(stamp, stamp)
    if arrivals:
        assert history.newest == max(arrivals)
        assert history.oldest is not None
        assert history.oldest >= max(arrivals) - length
        assert [stamp for stamp, _ in history.latest(3)] == sorted(
            {s for s in arrivals if s >= history.oldest}
        )[-3:]


@given(stamps, st.integers(0, 1000))
def test_forgetting_what_is_newer(arrivals: list[int], limit: int) -> None:
    history: StampedHistory[int] = StampedHistory(10_000)
    for stamp in arrivals:
        history.insert(stamp, stamp)
    history.forget_after(limit)
    assert len(history) == len({s for s in arrivals if s <= limit})


def test_second_value_of_a_stamp_replaces_the_first() -> None:
    history: StampedHistory[str] = StampedHistory(10)
    history.insert(1, "first")
    history.insert(1, "second")
    assert history.around(1) == ("second", "second", 0.0)
