"""Who has yet to take in what, in lock-step replay."""

from __future__ import annotations

from whereabouts.nodes.runtime.flow import Flow

LISTENERS = {"/middle": ["/b", "/c"], "/tf": ["/a", "/b"]}
NODES = ("/a", "/b", "/c")


def flow() -> Flow:
    return Flow(lambda topic: LISTENERS.get(topic, []))


def due(state: Flow) -> list[str]:
    return [node for node in NODES if state.due(node, ())]


def said(state: Flow, node: str, **outputs: int) -> None:
    """A node says how much it has published."""
    state.note(node, {}, {f"/{name}": count for name, count in outputs.items()})


def turns(state: Flow) -> dict[str, dict[str, int]]:
    """All who are to take something in do so; what each is told."""
    given = {node: state.give(node) for node in due(state)}
    for node in given:
        state.taken(node)
    return given


def test_a_node_has_a_turn_when_something_was_sent_that_it_listens_to() -> None:
    state = flow()
    assert due(state) == []
    said(state, "/a", middle=1)
    assert turns(state) == {"/b": {"/middle": 1}, "/c": {"/middle": 1}}
    assert due(state) == []
    assert state.received("/b")["/middle"] == 1
    assert (state.published("/middle"), state.total("/middle")) == (1, 1)


def test_a_topic_of_several_publishers_counts_all_of_them() -> None:
    state = flow()
    state.send("/tf", 5)
    # The node hears its own transforms too: 7 in all.
    said(state, "/a", tf=2)
    assert turns(state) == {"/a": {"/tf": 7}, "/b": {"/tf": 7}}
    assert (state.published("/tf"), state.total("/tf")) == (2, 7)


def test_what_is_lazy_makes_nobody_due_until_there_is_much_of_it() -> None:
    state = flow()
    state.send("/tf", 40)
    assert not state.due("/a", {"/tf"})
    state.send("/tf")
    assert state.due("/a", {"/tf"})


def test_counters_that_a_restart_begins_anew_go_on() -> None:
    state = flow()
    said(state, "/a", middle=9)
    turns(state)
    state.died("/a")
    said(state, "/a", middle=1)
    assert turns(state) == {"/b": {"/middle": 10}, "/c": {"/middle": 10}}
    # A listener that comes back has missed what there was, but for one that it was told once more.
    state.died("/b")
    said(state, "/a", middle=3)
    state.note("/b", {"/middle": 1}, {})
    state.begin("/b")
    assert turns(state) == {"/c": {"/middle": 12}}
    said(state, "/a", middle=4)
    assert turns(state) == {"/b": {"/middle": 2}, "/c": {"/middle": 13}}


def test_a_report_that_was_overtaken_changes_nothing() -> None:
    state = flow()
    said(state, "/a", middle=9)
    turns(state)
    state.note("/b", {"/middle": 7}, {})
    said(state, "/a", middle=8)
    assert due(state) == []
    assert state.received("/b")["/middle"] == 9


def test_at_a_rate_a_node_is_behind_until_it_says_that_it_has_taken_all_in() -> None:
    state = flow()
    state.send("/tf", 2)
    state.note("/a", {"/tf": 1}, {})
    assert [node for node in NODES if state.behind(node)] == ["/a", "/b"]
    state.note("/a", {"/tf": 2}, {})
    state.begin("/b")
    assert [node for node in NODES if state.behind(node)] == []
    state.send("/tf")
    assert [node for node in NODES if state.behind(node)] == ["/a", "/b"]
