"""Continuous attributes as Gaussians: in association, in symbols, in memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimation.errors import InputError
from whereabouts.recorded.evidence_messages import Reader
from whereabouts.recorded.world_log import EvidenceLog
from whereabouts.simulation.world_bag import EvidenceWriter
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig
from world_model.anchoring.attributes import Quantities

REGION = ((-3.0, 3.0), (-3.0, 3.0), (0.0, 2.0))
SENSOR = {"pose": (-4.0, 0.0, 1.0, 0.0), "range": 20.0, "angle": 2.0 * np.pi}
CUP = {"class": {"cup": 0.9, "bowl": 0.1}}


def config(**more: Any) -> WorldModelConfig:
    return WorldModelConfig(classes=("cup", "bowl"), region=REGION, **more)


def cup(x: float, size: float, sigma: float = 0.01, y: float = 0.0) -> ObjectEvidence:
    return ObjectEvidence((x, y, 1.0), 9e-4 * np.eye(3), CUP, quantities={"size": (size, sigma**2)})


def test_a_size_is_estimated_like_a_kalman_filter_does() -> None:
    rng = np.random.default_rng(0)
    model = WorldModel(config())
    sizes = 0.12 + rng.normal(0.0, 0.02, 30)
    for k, size in enumerate(sizes):
        state = model.update(WorldEvidence([cup(0.0, size, 0.02)], SENSOR), 0.05 * k)
    mean, variance = state.objects[0].quantities["size"]
    # Information form: the prior over all objects, and every measurement.
    information = 1.0 / 0.3**2 + 30 / 0.02**2
    assert variance == pytest.approx(1.0 / information, rel=1e-6)
    assert mean == pytest.approx((0.3 / 0.3**2 + sizes.sum() / 0.02**2) / information, rel=1e-6)
    assert "ratio" not in state.objects[0].quantities


def test_size_tells_twins_apart_that_have_changed_places() -> None:
    """Nothing but their sizes says which is which after nobody has looked for a while."""
    motion = {"*": {"model": "static", "moved_per_second": 0.05}}
    known = {}
    for told in (True, False):
        model = WorldModel(config(motion=motion, new_objects_per_second=1e-4))

        def look(big: float, small: float, told: bool = told) -> WorldEvidence:
            seen = [cup(big, 0.3, y=0.5), cup(small, 0.1, y=0.5)]
            if not told:
                seen = [ObjectEvidence(item.position, item.covariance, CUP) for item in seen]
            return WorldEvidence(seen, SENSOR)

        for k in range(40):
            state = model.update(look(-1.0, -0.88), 0.05 * k)
        names = {round(float(item.position[0]), 1): item.id for item in state.objects}
        for k in range(40):
            state = model.update(look(-0.88, -1.0), 30.0 + 0.05 * k)
        after = {round(float(item.position[0]), 1): item.id for item in state.objects}
        known[told] = (names[-1.0] == after[-0.9], len(after))
    assert known[True] == (True, 2)
    assert known[False] == (False, 2)


def test_symbols_follow_from_quantities() -> None:
    model = WorldModel(config())
    for k in range(10):
        seen = [
            cup(0.0, 0.1),
            cup(1.0, 0.2),
            cup(2.0, 0.4),
            ObjectEvidence((2.0, 1.0, 1.0), 9e-4 * np.eye(3), CUP),
        ]
        state = model.update(WorldEvidence(seen, SENSOR), 0.05 * k)
    sizes = ("small", "medium", "large")
    said = [model.words.described(item).predicates for item in state.objects]
    assert [[word for word in words if word in sizes] for words in said] == [
        ["small"],
        ["medium"],
        ["large"],
        [],
    ]
    [answer] = model.query(predicate="small", min_probability=0.5)
    assert answer.object.id == "cup-1"


def test_quantities_are_remembered(tmp_path: Path) -> None:
    model = WorldModel(config(), store=tmp_path / "world.sqlite")
    for k in range(10):
        state = model.update(WorldEvidence([cup(0.0, 0.1)], SENSOR), 0.05 * k)
    model.store.close()  # type: ignore[union-attr]
    again = WorldModel(config(), store=tmp_path / "world.sqlite")
    [item] = again.propagate(again.stamp).objects
    assert item.quantities["size"][0] == pytest.approx(state.objects[0].quantities["size"][0], abs=0.02)
    again.store.close()  # type: ignore[union-attr]


def test_sizes_come_from_messages_and_go_into_bags(tmp_path: Path) -> None:
    reader = Reader({"class": ["cup", "bowl"]}, ("class",), 0.03, quantities=("size",))
    with EvidenceWriter(tmp_path / "looks.mcap") as writer:
        writer.write(WorldEvidence([cup(0.0, 0.12)], SENSOR), 100.0)
    with EvidenceLog(tmp_path / "looks.mcap", reader) as log:
        [look] = list(log.looks())
    [item] = look.evidence.objects
    assert item.quantities["size"] == pytest.approx((0.12, 1e-4))
    assert set(item.attributes) == {"class"}


@pytest.mark.parametrize(
    "bad", [{"taste": (1.0, 1.0)}, {"size": (1.0, -1.0)}, {"size": 1.0}, {"size": (np.nan, 1.0)}]
)
def test_bad_quantities_are_refused_by_name(bad: Any) -> None:
    model = WorldModel(config())
    wrong = WorldEvidence([ObjectEvidence((0.0, 0.0, 1.0), None, CUP, quantities=bad)], SENSOR)
    with pytest.raises(InputError, match=r"objects\[0\].quantities"):
        model.update(wrong, 0.0)
    assert list(model.usable(wrong)[1]) == [0]
    with pytest.raises(InputError, match="quantities"):
        config(quantities={"size": (0.3, 0.0)})


@pytest.mark.parametrize(("model", "follows"), [("static", False), ("constant_velocity", True)])
def test_what_moves_shows_other_sides(model: str, follows: bool) -> None:
    world = WorldModel(WorldModelConfig(region=REGION, motion={"*": {"model": model}}))
    for k in range(40):
        size = 0.3 if k < 30 else 0.4
        seen = ObjectEvidence((0.0, 0.0, 1.0), 9e-4 * np.eye(3), quantities={"size": (size, 0.04)})
        state = world.update(WorldEvidence([seen], SENSOR), 0.05 * k)
    assert (state.objects[0].quantities["size"][0] > 0.38) == follows


def test_a_small_size_is_a_quantile_of_all_sizes() -> None:
    rng = np.random.default_rng(0)
    spread = np.sqrt(np.log1p((2.0 / 3.0) ** 2))
    drawn = rng.lognormal(np.log(3.0) - 0.5 * spread**2, spread, 100_000)
    assert drawn.mean() == pytest.approx(3.0, rel=0.02)
    assert Quantities({"size": (3.0, 2.0)}).small("size") == pytest.approx(
        np.quantile(drawn, 0.1587), rel=0.03
    )
    assert np.isnan(Quantities({"ratio": (1.0, 0.5)}).small("size"))
