"""What the report of a real recording says of its figures."""

from __future__ import annotations

from evaluation.demo.recorded import lead_of

FOUND = {"bag_s": 720.0, "wall_s": 240.0, "path_m": 812.4, "labels": 3, "unsure": 0.01}


def test_a_way_is_told_as_a_fact_only_where_the_registration_was_sure_of_it() -> None:
    assert "The robot drove 812 m;" in lead_of(FOUND)
    assert "are rough" not in lead_of(FOUND)
    unsure = lead_of({**FOUND, "unsure": 0.48})
    assert "believed to have driven 812 m" in unsure
    assert "In 48 % of the scans" in unsure


def test_a_robot_that_does_not_move_stood_still() -> None:
    assert "The robot stood still; 3 people" in lead_of({**FOUND, "path_m": 0.0})
