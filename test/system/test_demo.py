"""The first seconds of the demo's bag through all nodes, to the page."""

from __future__ import annotations

from pathlib import Path

from whereabouts.demo.replay import Script, replay
from whereabouts.demo.report import figures, judge, write
from whereabouts.simulation.apartment_bag import START, record

SECONDS = 12.0


def test_an_excerpt_of_the_apartment_becomes_a_report(tmp_path: Path) -> None:
    bag = tmp_path / "excerpt.mcap"
    record(bag, SECONDS)
    # The cup on the kitchen table is in view then.
    recording, run = replay(bag, tmp_path / "out", script=Script("cup", START + 10.5, START + 11.0))
    judged = judge(recording, bag, run)
    page = write(tmp_path / "out", judged)

    assert run.account.total_lost == 0
    assert run.account.bag_seconds == SECONDS
    assert set(run.usage) == {
        f"/{name}"
        for name in (
            "scan_registration", "loop_closure", "target_tracker", "motion_predictor", "world_model",
            "world_maintenance", "verifier", "object_search",
        )
    }  # fmt: skip
    assert all(20.0 < usage.resident < 1000.0 for usage in run.usage.values())
    found = figures(judged)
    assert found["loops_closed_rmse_m"] < 0.05 < found["wheels_max_m"]
    assert found["things_right"] >= 2
    assert found["things_extra"] == []
    assert found["identity_switches"] == 0
    assert run.told.verification == "cup-1 is next to be observed"
    assert run.told.found, run.told
    assert run.told.object_id == "cup-1"

    text = page.read_text(encoding="utf-8")
    for name in ("map", "trajectory", "people", "predictions", "world", "search"):
        assert f'src="{name}.png"' in text
        picture = (page.parent / f"{name}.png").read_bytes()
        assert picture.startswith(b"\x89PNG")
        assert len(picture) > 10_000
    for name in run.usage:
        assert f"<td>{name.strip('/')}</td>" in text
