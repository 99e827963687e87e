"""The first seconds of the demo's bag through all nodes, to the page."""

from __future__ import annotations

from pathlib import Path

import pytest

from estimation.errors import InputError
from evaluation.demo import recorded
from evaluation.demo.demo_report import figures, judge, write
from evaluation.demo.demo_runs import node_parameters
from evaluation.demo.replay import DemoScript, replay
from whereabouts.simulation.home.apartment_bag import START, record

SECONDS = 12.0


def test_an_excerpt_of_the_apartment_becomes_a_report(tmp_path: Path) -> None:
    bag = tmp_path / "excerpt.mcap"
    record(bag, SECONDS)
    # The cup on the kitchen table is in view then.
    recording, run = replay(bag, tmp_path / "out", script=DemoScript("cup", START + 10.5, START + 11.0))
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
    assert found["nodes_heard"] == 8
    assert found["loops_closed_rmse_m"] < 0.05 < found["wheels_max_m"]
    assert found["things_right"] >= 2
    assert found["things_extra"] == []
    assert found["identity_switches"] == 0
    # A name is given by the first look, whatever class it said; the red cup is the one that is asked for.
    assert run.told.verification in (
        f"the red cup{name} is next to be observed" for name in ("", f" ({run.told.object_id})")
    ), run.told
    assert run.told.found, run.told
    assert run.told.place == pytest.approx((0.0, 3.5), abs=0.1)

    text = page.read_text(encoding="utf-8")
    for name in ("map", "trajectory", "people", "predictions", "world", "search"):
        assert f'src="{name}.png"' in text
        picture = (page.parent / f"{name}.png").read_bytes()
        assert picture.startswith(b"\x89PNG")
        assert len(picture) > 10_000
    for name in run.usage:
        assert f"<td>{name.strip('/')}</td>" in text


def test_a_bag_of_somebody_else_becomes_a_report_with_map_and_people(tmp_path: Path) -> None:
    bag = tmp_path / "other.mcap"
    record(bag, SECONDS)
    folder = tmp_path / "out"
    said, account = recorded.run_recorded(
        recorded.bag_of(str(bag), folder), folder, node_parameters(bag), None, print, lambda share: None
    )
    text = recorded.write(folder, bag, said, account).read_text(encoding="utf-8")

    assert account.total_lost == 0
    assert len(said.replayed.poses) > 8.0 * SECONDS
    assert said.grid is not None
    assert said.people
    assert '"map":{"src":"data:image/png;base64,' in text
    assert "nobody is called false here" in text
    assert 'href="recording.mcap"' in text


def test_recordings_that_are_not_there_are_said_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WHEREABOUTS_DATA", str(tmp_path / "nothing"))
    with pytest.raises(InputError, match=r"outdoor.*not on this machine"):
        recorded.bag_of("outdoor", tmp_path)
    with pytest.raises(InputError, match="there is no file"):
        recorded.bag_of("elsewhere.bag", tmp_path)
