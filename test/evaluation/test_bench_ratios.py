"""The comparison of processor times with other libraries: what counts as worse."""

from __future__ import annotations

import importlib.util
import json
import time
from pathlib import Path
from types import ModuleType

import pytest

FOLDER = Path(__file__).parents[2] / "bench"


@pytest.fixture(scope="module")
def ratios() -> ModuleType:
    spec = importlib.util.spec_from_file_location("ratios", FOLDER / "ratios.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FOLDER))
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
            patch.setenv(name, "1")
        spec.loader.exec_module(module)
    return module


def test_a_ratio_is_of_processor_times(ratios: ModuleType) -> None:
    def busy(seconds: float) -> None:
        until = time.process_time() + seconds
        while time.process_time() < until:
            pass

    low, middle, high = ratios.measured(lambda: busy(0.01), lambda: busy(0.04), 5)
    assert low <= middle <= high
    assert 0.1 < middle < 0.6


def test_worse_is_by_more_than_the_spread_of_both(ratios: ModuleType) -> None:
    assert ratios.worse([1.9, 2.0, 2.1], [0.9, 1.0, 1.1])
    assert not ratios.worse([1.0, 1.2, 1.4], [0.9, 1.0, 1.1])
    assert not ratios.worse([0.4, 0.5, 0.6], [0.9, 1.0, 1.1])


def test_what_is_kept_can_be_checked(
    ratios: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = json.loads((FOLDER / "ratios.json").read_text(encoding="utf-8"))
    assert all(row["quartiles"] == sorted(row["quartiles"]) and row["beside"] for row in kept.values())

    def pairs() -> list[tuple[str, object, str, object]]:
        return [("sums", lambda: sum(range(200_000)), "shorter sums", lambda: sum(range(20_000)))]

    monkeypatch.setattr(ratios, "pairs", pairs)
    monkeypatch.setattr(ratios, "KEPT", tmp_path / "ratios.json")
    assert ratios.main(["--turns", "3"]) == 0
    written = json.loads(ratios.KEPT.read_text(encoding="utf-8"))
    assert set(written) == {"sums"}
    written["sums"]["quartiles"] = [0.001, 0.001, 0.001]
    ratios.KEPT.write_text(json.dumps(written), encoding="utf-8")
    ratios.main(["--turns", "3", "--check"])
    assert "was 0.001" in capsys.readouterr().out
