"""Symbols: probabilities against drawn samples, the text's own relations, and what is wrong with a file."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from estimation.errors import InputError
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig, ask
from world_model.symbols import Symbols, default_symbols, parse_symbol

DEGREE = math.pi / 180.0
ATTRIBUTES = {"class": {"cup": 0.7, "bowl": 0.2, "shoe": 0.1}, "color": {"red": 0.6, "blue": 0.4}}


def test_symbols_of_discrete_attributes_are_their_probabilities() -> None:
    symbols = default_symbols()
    assert symbols.probability("red", ATTRIBUTES) == 0.6
    assert symbols.probability("cup", ATTRIBUTES) == 0.7
    assert symbols.probability("dish", ATTRIBUTES) == pytest.approx(0.9)
    assert symbols.probability("colorful", ATTRIBUTES) == pytest.approx(1.0)
    assert symbols.probability("green", ATTRIBUTES) == 0.0
    # Of the size nothing is known.
    assert symbols.probability("small", ATTRIBUTES) == pytest.approx(1.0 / 3.0)


def test_symbols_that_probably_hold_are_listed_without_those_of_ignorance() -> None:
    held = default_symbols().holding({**ATTRIBUTES, "material": {"steel": 0.8, "wood": 0.2}})
    assert list(held) == ["colorful", "dish", "steel", "red"]


def test_mass_of_a_region_agrees_with_samples_also_across_the_end_of_the_circle() -> None:
    rng = np.random.default_rng(2)
    hue = rng.normal(350.0, 20.0, 200_000) % 360.0
    saturation, value = rng.normal(0.4, 0.15, 200_000), rng.normal(0.3, 0.1, 200_000)
    red = ((hue >= 340.0) | (hue <= 15.0)) & (saturation >= 0.3) & (value >= 0.2)
    measured = {
        "hue": (-10.0 * DEGREE, (20.0 * DEGREE) ** 2),
        "saturation": (0.4, 0.15**2),
        "value": (0.3, 0.1**2),
    }
    assert default_symbols().probability("red", {}, measured) == pytest.approx(red.mean(), abs=0.005)


def test_perceived_colours_sum_to_one_and_follow_the_hue() -> None:
    symbols = default_symbols()
    for degrees, expected in (
        (0.0, "red"),
        (120.0, "green"),
        (220.0, "blue"),
        (350.0, "red"),
        (58.0, "yellow"),
    ):
        measured = {"hue": (degrees * DEGREE, 0.003), "saturation": (0.8, 0.01), "value": (0.7, 0.01)}
        colour = symbols.perceived(measured)["color"]
        assert sum(colour.values()) == pytest.approx(1.0)
        assert max(colour, key=colour.__getitem__) == expected
    some = symbols.perceived(measured, known={"color": ["red", "blue"]})["color"]
    assert set(some) == {"red", "blue"}
    assert sum(some.values()) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("size", "ratio", "expected"),
    [
        (0.10, 1.0, {"small", "square"}),
        (0.20, 1.8, {"medium", "rectangle"}),
        (0.20, 0.3, {"medium", "rectangle"}),
        (0.40, 1.2, {"large", "square"}),
    ],
)
def test_sizes_and_shapes_of_the_text(size: float, ratio: float, expected: set[str]) -> None:
    held = default_symbols().holding({}, {"size": (size, 1e-4), "ratio": (ratio, 1e-3)}, 0.9)
    assert set(held) == expected


def test_symbols_give_distributions_that_give_the_symbols_back() -> None:
    symbols = default_symbols()
    found = symbols.grounding(["small", "red", "cup"])
    assert found.discrete == {"size": {"small": 1.0}, "color": {"red": 1.0}, "class": {"cup": 1.0}}
    mean, variance = found.continuous["size"]
    assert (mean, variance) == (pytest.approx(0.075), pytest.approx(0.15**2 / 12.0))
    for word in ("small", "red", "cup"):
        assert symbols.probability(word, found.discrete) == 1.0
    for colour in symbols.of_attribute("color"):
        quantities = {name: (m, 1e-6) for name, (m, _) in symbols.grounding([colour]).continuous.items()}
        assert symbols.probability(colour, {}, quantities) > 0.999
    assert symbols.grounding(["dish", "cup"]).discrete == {"class": {"cup": 1.0}}
    with pytest.raises(InputError, match=r"'red' excludes.*blue"):
        symbols.grounding(["blue", "red"])


def test_vectors_are_unpacked_and_checked() -> None:
    symbols = default_symbols()
    found = symbols.unpacked("hsv", [1.0, 0.5, 0.6], np.diag([0.01, 0.02, 0.03]).ravel())
    assert found == {"hue": (1.0, 0.01), "saturation": (0.5, 0.02), "value": (0.6, 0.03)}
    for name, mean, covariance, message in (
        ("hsv", [1.0], [1.0], "3 values"),
        ("weight", [1.0], [1.0], "unknown quantity 'weight'"),
        ("hue", [math.nan], [1.0], "finite"),
        ("hsv", [0.0, 0.0, 0.0], np.diag([1.0, 1.0, -1.0]).ravel(), "negative eigenvalues"),
    ):
        with pytest.raises(InputError, match=message):
            symbols.unpacked(name, mean, covariance)


def test_words_nobody_knows_are_refused() -> None:
    default_symbols().require("red", ())
    default_symbols().require("cup", ["cup"])
    with pytest.raises(InputError, match="unknown predicate 'shiny'"):
        default_symbols().require("shiny", ["cup"])


def test_object_symbols_both_ways() -> None:
    assert parse_symbol("tea-can-12") == ("tea-can", 12)
    assert parse_symbol("the good cup") is None


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("predicates: {red: {attribute: color, where: {hew: [0, 1]}}}", "unknown quantity 'hew'"),
        ("predicates: {red: {where: {}}}", "an attribute expected"),
        (
            "{quantities: {s: {}}, predicates: {a: {attribute: b, where: {s: [2, 1]}}}}",
            "predicate 'a', s: .*ascending",
        ),
        (
            "{quantities: {s: {}}, predicates: {a: {attribute: b, where: {s: [x, 1]}}}}",
            r"predicates\.a\.where\.s.*valid number, got 'x'",
        ),
        (
            "{quantities: {s: {}}, predicates: {a: {attribute: b, where: {s: 3}}}}",
            r"predicates\.a\.where\.s: .*valid list, got 3",
        ),
        ("predicates: {a: {any: [b]}, b: {any: [a]}}", "defined by itself"),
        ("predicates: {a: {any: [b], attribute: c}}", "either any"),
        ("predicates: {a: {colour: b}}", r"predicates\.a\.colour: Extra inputs"),
        ("predicate: {}", "predicate: Extra inputs"),
        ("[1, 2]", r"valid dictionary, got \[1, 2\]"),
        ("a: [", "cannot be read"),
    ],
)
def test_what_is_wrong_with_a_file_is_said(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "predicates.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=expected) as caught:
        Symbols.load(path)
    assert str(path) in str(caught.value)


def test_of_two_values_that_are_as_likely_neither_is_told() -> None:
    model = WorldModel(WorldModelConfig(classes=("cup", "bowl"), colors=("red", "blue")))
    cup = ObjectEvidence((1.0, 0.2, 0.8), 1e-3 * np.eye(3), {"class": {"cup": 1.0}})
    for stamp in range(4):
        model.update(WorldEvidence([cup]), float(stamp))
    (answer,) = model.query(class_name="cup")
    assert answer.description.startswith("the cup (cup-1)")
    assert not {"red", "blue"} & set(answer.object.predicates)
    assert ask(model, "where is the cup?").sentence.startswith("cup-1 is at")
