"""MRCLAM tables: what is stated is depth along the camera's axis, what is read is distance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evaluation.anchoring import mrclam


def test_distance_and_bearing_lead_to_the_landmark(tmp_path: Path) -> None:
    """A camera at (1, 2) that looks along x and states the depth of a landmark off its axis."""
    (tmp_path / "Barcodes.dat").write_text("# Subject Barcode\n7 63\n", encoding="utf-8")
    poses = "".join(f"{t} 1.0 2.0 0.0\n" for t in (0.0, 1.0))
    (tmp_path / "Robot1_Groundtruth.dat").write_text(poses, encoding="utf-8")
    landmark = np.array([4.0, 3.5])
    depth, bearing = 3.0, np.arctan2(1.5, 3.0)
    (tmp_path / "Robot1_Measurement.dat").write_text(f"0.5 63 {depth} {bearing:.9f}\n", encoding="utf-8")
    (seen,) = mrclam.sightings(tmp_path, 1)
    distance, angle = seen.readings[0]
    found = seen.pose[:2] + distance * np.array([np.cos(angle), np.sin(angle)])
    assert found == pytest.approx(landmark, abs=1e-6)
    assert seen.subjects.tolist() == [7]
