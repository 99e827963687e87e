"""Warnings of nodes on the terminal."""

from __future__ import annotations

from pathlib import Path

from whereabouts.nodes.runtime.log_echo import LogEcho


def test_what_nodes_warn_of_is_told_once_and_in_whole_lines(tmp_path: Path) -> None:
    told: list[str] = []
    echo, log, other = LogEcho(told.append), tmp_path / "a.log", tmp_path / "none.log"
    log.write_text("[INFO] [12.5] [mapper]: reading\n[WARN] [12.6] [mapper]: /scan: no tran")
    echo.look([log, other], now=True)
    assert told == []
    with log.open("a") as file:
        file.write("sform to [base]\nTraceback:\n[ERROR] [12.7] [robot1.mapper]: it is füll\n")
    echo.look([log, other], now=True)
    echo.look([log, other], now=True)
    assert told == ["mapper: /scan: no transform to [base]", "robot1.mapper: it is füll"]
    log.write_text("[FATAL] [1.0] [mapper]: anew\n")
    echo.look([log], now=True)
    assert told[2:] == ["mapper: anew"]


def test_a_log_that_grows_too_fast_is_not_read_whole(tmp_path: Path) -> None:
    told: list[str] = []
    log = tmp_path / "a.log"
    log.write_text("[WARN] [1.0] [n]: " + "x" * 100 + "\n" + "y" * 200_000 + "\n[WARN] [2.0] [n]: end\n")
    LogEcho(told.append).look([log], now=True)
    assert told == ["n: end"]
