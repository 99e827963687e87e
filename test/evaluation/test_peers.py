"""Peers that are not here are left out of the experiment `peers` with a sentence."""

import sys
from pathlib import Path

import pytest

from evaluation.experiments import peers
from evaluation.peers import kiss_slam_peer
from evaluation.running import Run, run


def test_a_peer_that_cannot_be_imported_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # An environment as `make peers` leaves one whose packages are damaged: there is a Python, and no KISS-SLAM.
    monkeypatch.setattr(kiss_slam_peer, "INTERPRETER", Path(sys.executable))
    monkeypatch.setattr(peers, "PARTS", {"round of clouds": peers.PARTS["round of clouds"]})
    found = run(Run("peers", tmp_path, quick=True))
    assert found.tables == []
    assert any("KISS-SLAM" in note and "left out" in note for note in found.content["notes"])
