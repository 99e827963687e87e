"""Who has yet to take in what, in lock-step replay."""

from __future__ import annotations

from whereabouts.nodes.runtime.flow import Flow

LISTENERS = {"/middle": ["/b", "/c"], "/tf": ["/a", "/b"]}


def flow(sent: dict[str, int] | None = None) -> Flow:
    return Flow(lambda topic: LISTENERS.get(topic, []), lambda topic: (sent or {}).get(topic, 0))


def report(topic: str, received: int, **outputs: int) -> tuple[dict[str, int], dict[str, int]]:
    return {topic: received}, {f"/{name}": count for name, count in outputs.items()}


def test_a_node_is_behind_until_it_has_received_what_another_sent() -> None:
    state = flow()
    assert state.behind() == []
    state.note("/a", *report("/scan", 1, middle=1))
    assert state.behind() == ["/b", "/c"]
    state.note("/b", *report("/middle", 1))
    assert state.behind() == ["/c"]
    state.note("/c", *report("/middle", 1))
    assert state.behind() == []


def test_a_topic_of_several_publishers_counts_all_of_them() -> None:
    sent = {"/tf": 5}
    state = flow(sent)
    state.note("/a", *report("/tf", 5, tf=2))
    # The node hears its own transforms too: 7 in all.
    assert sorted(state.behind()) == ["/a", "/b"]
    state.note("/a", *report("/tf", 7, tf=2))
    state.note("/b", *report("/tf", 6))
    assert state.behind() == ["/b"]
    state.note("/b", *report("/tf", 7))
    assert state.behind() == []


def test_counters_that_a_restart_begins_anew_go_on() -> None:
    state = flow()
    state.note("/a", *report("/scan", 9, middle=9))
    for node in ("/b", "/c"):
        state.note(node, *report("/middle", 9))
    state.died("/a")
    state.note("/a", *report("/scan", 1, middle=1))
    assert state.behind() == ["/b", "/c"]
    for node in ("/b", "/c"):
        state.note(node, *report("/middle", 10))
    assert state.behind() == []
    # A listener that comes back has missed one for good.
    state.died("/b")
    state.note("/a", *report("/scan", 3, middle=3))
    state.note("/b", *report("/middle", 1))
    state.note("/c", *report("/middle", 12))
    assert state.behind() == ["/b"]
    state.forgive()
    assert state.behind() == []
    state.note("/a", *report("/scan", 4, middle=4))
    assert state.behind() == ["/b", "/c"]


def test_a_report_that_was_overtaken_changes_nothing() -> None:
    state = flow()
    state.note("/a", *report("/scan", 9, middle=9))
    for node in ("/b", "/c"):
        state.note(node, *report("/middle", 9))
    state.note("/b", *report("/middle", 7))
    state.note("/a", *report("/scan", 8, middle=8))
    assert state.behind() == []


def test_what_a_listener_was_told_once_more_does_not_stand_for_what_is_still_to_come() -> None:
    state = flow()
    state.note("/a", *report("/scan", 1, middle=1))
    for node in ("/b", "/c"):
        state.note(node, *report("/middle", 1))
    state.died("/b")
    state.note("/b", *report("/middle", 1))
    state.forgive()
    state.note("/a", *report("/scan", 2, middle=2))
    state.note("/c", *report("/middle", 2))
    assert state.behind() == ["/b"]
