"""Blobs of the table experiment, grounded by Table 2.2 in drawn pixels, against counting pixels in its regions."""

import numpy as np
import pytest

from evaluation.anchoring.anchoring_blobs import (
    PRINTED,
    TABLE_2_2,
    Blob,
    colour,
    detection,
    outline,
    pixels,
)
from evaluation.anchoring.anchoring_table import BOTH, BOX, CAN, CUP, SECOND_BOX, TEA, dynamic_table

# Table 2.1, and the two boxes that are seen as one.
TABLE_2_1 = [
    (BOX, "green", "medium", "rectangle"),
    (SECOND_BOX, "green", "medium", "rectangle"),
    (CAN, "green", "small", "square"),
    (TEA, "red", "small", "square"),
    (CUP, "red", "small", "square"),
    (BOTH, "green", "large", "rectangle"),
]


@pytest.mark.parametrize(("blob", "color", "size", "shape"), TABLE_2_1)
def test_things_are_grounded_as_table_2_1_has_them(blob: Blob, color: str, size: str, shape: str) -> None:
    rng = np.random.default_rng(1)
    for fixed in (True, False):
        found = [detection(rng, blob, fixed).attributes for _ in range(100)]
        for name, said in (("color", color), ("size", size), ("shape", shape)):
            assert all(sum(each[name].values()) == pytest.approx(1.0) for each in found)
            assert np.mean([max(each[name], key=each[name].get) == said for each in found]) > 0.95
            if fixed:
                assert {max(each[name].values()) for each in found} == {PRINTED}


@pytest.mark.parametrize("hue", [2.0, 15.0, 64.0, 100.0, 165.0, 172.0, 178.0])
def test_the_share_of_pixels_in_a_region_is_its_probability(hue: float) -> None:
    """Counted pixel by pixel; hue wraps around."""
    drawn = pixels(np.random.default_rng(2), Blob(0.0, 0.0, (hue, 176.0, 120.0), 0.1, 0.1))
    h, s, v = drawn.T
    green = (h >= 15) & (h <= 65)
    red = (h >= 165) & (h <= 179) & (s >= 128) & (s <= 223) & (v >= 80) & (v <= 159)
    neither = 0.5 * (1.0 - green.mean() - red.mean())
    found = TABLE_2_2.perceived(colour(drawn))["color"]
    assert found["green"] == pytest.approx(green.mean() + neither, abs=0.05)
    assert found["red"] == pytest.approx(red.mean() + neither, abs=0.05)


def test_the_variance_of_the_ratio_is_that_of_many_boxes() -> None:
    rng = np.random.default_rng(3)
    ratios = [outline(rng, BOX)["ratio"][0] for _ in range(4000)]
    assert outline(rng, BOX)["ratio"][1] == pytest.approx(np.var(ratios), rel=0.15)


@pytest.mark.parametrize("fixed", [True, False])
def test_what_the_text_says_happens(fixed: bool) -> None:
    rows, shots = dynamic_table(4, fixed)
    assert {name: happens for name, _, happens in rows if name != "false box"} == {
        "moved": True,
        "exchanged": True,
        "second box": True,
    }
    assert len(shots["second box"].state.objects) == 4
