"""Who has yet to take in what, in lock-step replay."""

from __future__ import annotations

from whereabouts.nodes.flow import Flow
from whereabouts_msgs.msg import Processed

LISTENERS = {"/middle": ["/b", "/c"], "/tf": ["/a", "/b"]}


def flow(sent: dict[str, int] | None = None) -> Flow:
    return Flow(lambda topic: LISTENERS.get(topic, []), lambda topic: (sent or {}).get(topic, 0))


def report(topic: str, received: int, **outputs: int) -> Processed:
    names = [f"/{name}" for name in outputs]
    return Processed(
        topic=topic, received=received, output_topics=names, output_counts=list(outputs.values())
    )


def test_a_node_is_behind_until_it_has_received_what_another_sent() -> None:
    state = flow()
    assert state.behind() == []
    state.note("/a", report("/scan", 1, middle=1))
    assert state.behind() == ["/b", "/c"]
    state.note("/b", report("/middle", 1))
    assert state.behind() == ["/c"]
    state.note("/c", report("/middle", 1))
    assert state.behind() == []


def test_a_topic_of_several_publishers_counts_all_of_them() -> None:
    sent = {"/tf": 5}
    state = flow(sent)
    state.note("/a", report("/tf", 5, tf=2))
    # The node hears its own transforms too: 7 in all.
    assert sorted(state.behind()) == ["/a", "/b"]
    state.note("/a", report("/tf", 7, tf=2))
    state.note("/b", report("/tf", 6))
    assert state.behind() == ["/b"]
    state.note("/b", report("/tf", 7))
    assert state.behind() == []


def test_counters_that_a_restart_begins_anew_go_on() -> None:
    state = flow()
    state.note("/a", report("/scan", 9, middle=9))
    for node in ("/b", "/c"):
        state.note(node, report("/middle", 9))
    state.note("/a", report("/scan", 1, middle=1))
    assert state.behind() == ["/b", "/c"]
    for node in ("/b", "/c"):
        state.note(node, report("/middle", 10))
    assert state.behind() == []
    # A listener that comes back has missed one for good.
    state.note("/a", report("/scan", 3, middle=3))
    state.note("/b", report("/middle", 1))
    state.note("/c", report("/middle", 12))
    assert state.behind() == ["/b"]
    state.forgive()
    assert state.behind() == []
    state.note("/a", report("/scan", 4, middle=4))
    assert state.behind() == ["/b", "/c"]
