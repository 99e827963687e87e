"""Progress of long work where nobody looks at a terminal."""

from __future__ import annotations

import pytest

from whereabouts.system import progress


def test_off_a_terminal_long_work_says_now_and_then_how_far_it_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with progress.progress_bar() as bar:
        task = bar.add_task("mapping drive.mcap", total=100)
        for share in range(1, 101):
            now[0] += 0.5
            bar.update(task, completed=share)
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["mapping drive.mcap: 41 %", "mapping drive.mcap: 81 %"]


def test_short_work_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert list(progress.track(range(5), "counting")) == [0, 1, 2, 3, 4]
    assert capsys.readouterr().err == ""
