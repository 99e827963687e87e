"""Counted relations against counting by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.places import Places
from whereabouts.parameters.object_search import ObjectSearchParameters
from world_model.tasks.relations import Relations
from world_model.tasks.search import ObjectSearch

FRAMES = [["cup", "table"], ["cup", "table", "chair"], ["table"], ["lamp", "table", "table"], ["lamp"]]


def test_lidstone_probabilities_are_those_of_the_formula() -> None:
    relations = Relations.from_frames(FRAMES)
    # N(cup, table) = 2, N(table) = 4, four names, λ = 0.5: (2 + 0.5) / (4 + 2).
    assert relations.probability("cup", "table") == pytest.approx(2.5 / 6.0)
    assert relations.probability("cup", "lamp") == pytest.approx(0.5 / 4.0)
    assert relations.probability("table", "cup") == pytest.approx(2.5 / 4.0)
    index = {name: k for k, name in enumerate(relations.names)}
    matrix = relations.matrix()
    for one in relations.names:
        for other in relations.names:
            if one != other:
                assert matrix[index[one], index[other]] == pytest.approx(relations.probability(one, other))


@pytest.mark.parametrize("minimum", [0.0, 2.0])
def test_a_block_is_cut_out_of_the_whole_matrix(minimum: float) -> None:
    relations = Relations.from_frames(FRAMES, minimum=minimum)
    few, every = np.array([2, 0]), np.arange(len(relations.names))
    apart = [relations.block(few, every), relations.block(every, few)]
    matrix = relations.matrix()
    np.testing.assert_allclose(apart[0], matrix[few])
    np.testing.assert_allclose(apart[1], matrix[:, few])


def test_relations_of_a_room_type_count_its_frames_before_all_others() -> None:
    """Cups stand on tables in kitchens and on desks in offices; the whole is the prior of each, with weight λ n."""
    relations = Relations(smoothing=0.25)
    frames = [("kitchen", ["cup", "table"], 6), ("kitchen", ["table"], 2), ("office", ["cup", "desk"], 5)]
    frames += [("office", ["table", "lamp"], 3), ("office", ["desk"], 1)]
    for room, names, count in frames:
        for _ in range(count):
            relations.observe(names, room)
    names = relations.names
    every, weight = np.arange(len(names)), 0.25 * len(names)
    whole = relations.matrix()
    for kind in ("kitchen", "office"):
        shown = [(set(n), c) for room, n, c in frames if room == kind]
        found, common = relations.block(every, every, kind), relations.ubiquity(kind)
        for j, given in enumerate(names):
            there = sum(c for n, c in shown if given in n)
            for i, name in enumerate(names):
                both = sum(c for n, c in shown if {name, given} <= n)
                assert found[i, j] == pytest.approx((both + weight * whole[i, j]) / (there + weight))
            share = (there + weight * relations.ubiquity()[j]) / (sum(c for _, c in shown) + weight)
            assert common[j] == pytest.approx(share)
    np.testing.assert_array_equal(relations.block(every, every, "garden"), whole)
    few = np.array([2, 0])
    np.testing.assert_allclose(
        relations.block(few, every, "office"), relations.block(every, every, "office")[few]
    )


def test_a_search_follows_the_relations_of_the_room_it_is_in() -> None:
    """Books lie beside lamps in bedrooms and beside plants in offices, as often."""
    relations = Relations()
    for _ in range(30):
        relations.observe(["book", "lamp"], "bedroom")
        relations.observe(["plant"], "bedroom")
        relations.observe(["book", "plant"], "office")
        relations.observe(["lamp"], "office")
    for kind, wanted in (("bedroom", "lamp"), ("office", "plant")):
        square = [[-4, -4], [4, -4], [4, 4], [-4, 4]]
        places = Places.from_mapping({"places": {"here": {"polygon": square, "type": kind}}})
        search = ObjectSearch(relations, places=places)
        step = search.next_goal({"lamp": [2.0, 1.0], "plant": [2.0, -1.0]}, "book", [0.0, 0.0, 0.0])
        assert step.object == wanted


def test_posterior_is_bayes_law_over_what_is_in_view() -> None:
    relations = Relations.from_frames(FRAMES)
    posterior = relations.posterior("cup", ["table", "lamp"])
    joint = {name: relations.probability("cup", name) * n for name, n in (("table", 4.0), ("lamp", 2.0))}
    for name, value in joint.items():
        assert posterior[name] == pytest.approx(value / sum(joint.values()))


def test_fading_weighs_a_frame_by_its_age() -> None:
    relations = Relations(fading=0.5)
    for names in (["cup", "table"], ["cup"], ["cup", "table"]):
        relations.observe(names)
    assert relations.count("cup") == pytest.approx(0.25 + 0.5 + 1.0)
    assert relations.count("cup", "table") == pytest.approx(0.25 + 1.0)
    for _ in range(200):
        relations.observe(["lamp"])
    assert relations.count("lamp") == pytest.approx(2.0, rel=1e-6)
    assert np.isfinite(relations.matrix()).all()


def test_rare_pairs_are_dropped_and_synonyms_are_one() -> None:
    relations = Relations(minimum=2.0, synonyms={"bedstand": "nightstand"})
    for names in (["Bedstand", "lamp"], ["nightstand", "lamp"], ["nightstand", "bed"]):
        relations.observe(names)
    assert relations.count("nightstand") == 3.0
    floor = 0.5 / (3.0 + 0.5 * 3)
    assert relations.probability("bed", "bedstand") == pytest.approx(floor)
    assert relations.probability("lamp", "bedstand") == pytest.approx((2.0 + 0.5) / (3.0 + 0.5 * 3))


def test_rooms_follow_from_where_things_were_seen() -> None:
    relations = Relations()
    for _ in range(8):
        relations.observe(["sink", "cup"], room="kitchen")
        relations.observe(["desk"], room="office")
    rooms = relations.rooms("cup", ["kitchen", "office"])
    assert sum(rooms.values()) == pytest.approx(1.0)
    assert rooms["kitchen"] == pytest.approx(8.5 / 9.0)


def test_unknown_names_and_no_counts_are_no_failure() -> None:
    empty = Relations()
    assert empty.probability("cup", "table") == 1.0
    assert empty.posterior("cup", []) == {}
    assert empty.matrix().shape == (0, 0)
    relations = Relations.from_frames(FRAMES)
    assert 0.0 < relations.probability("unicorn", "table") < 0.2
    assert "unicorn" not in relations


def test_shipped_common_sense_reads_and_makes_sense() -> None:
    relations = Relations.common_sense()
    assert relations.probability("pillow", "bed") > relations.probability("pillow", "fridge")
    assert relations.rooms("toothbrush", ["bathroom", "kitchen"])["bathroom"] > 0.3


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("frames: 3", "frames"),
        ("[1, 2]", "frames"),
        ("frames: [[1, 2]]", "frame 1"),
        ("frames: [{names: [a], count: -1}]", "frame 1"),
        ("frames: [a: {", "cannot be read"),
        ("{frames: [[a]], synonyms: {a: b, b: a}}", "leads back"),
        ("{frames: [[a]], synonyms: 3}", "synonyms"),
    ],
)
def test_malformed_files_are_named(tmp_path: Path, text: str, named: str) -> None:
    path = tmp_path / "relations.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=named):
        Relations.load(path)


def test_synonyms_of_synonyms_are_followed_and_circles_are_refused() -> None:
    relations = Relations(synonyms={"Settee": "sofa", "sofa": "Couch", "couch": "couch"})
    relations.observe(["settee", "lamp"])
    relations.observe(["sofa", "lamp"])
    assert relations.names == ["couch", "lamp"]
    assert relations.count("couch", "lamp") == 2.0
    with pytest.raises(InputError, match="'mug' leads back"):
        Relations(synonyms={"mug": "cup", "cup": "beaker", "beaker": "cup"})
    with pytest.raises(InputError, match="words"):
        Relations(synonyms={"mug": 3})  # type: ignore[dict-item]


@pytest.mark.parametrize("smoothing", [0.0, 0.5])
def test_counts_of_zero_and_at_odds_with_each_other_are_no_failure(smoothing: float) -> None:
    relations = Relations(smoothing)
    relations.observe(["cup", "table"], room="kitchen", count=0.0)
    relations.observe(["lamp"], count=0.0)
    for _ in range(2):
        matrix = relations.matrix()
        assert np.isfinite(matrix).all()
        assert (matrix >= 0.0).all()
        assert np.isfinite(list(relations.posterior("cup", ["table", "lamp"]).values())).all()
        assert np.isfinite(list(relations.rooms("cup", ["kitchen", "cellar"]).values())).all()
        step = ObjectSearch(relations).next_goal(
            {"table": [1.0, 0.0], "lamp": [0.0, 2.0]}, "cup", [0.0, 0.0, 0.0]
        )
        assert step.goal is not None
        assert np.isfinite(step.goal).all()
        # Never together before, and always together now.
        relations.observe(["cup", "lamp"], room="cellar")


def test_wrong_numbers_are_refused() -> None:
    with pytest.raises(InputError, match="smoothing"):
        Relations(smoothing=-1.0)
    with pytest.raises(InputError, match="fading"):
        Relations(fading=0.0)
    with pytest.raises(InputError, match="count"):
        Relations().observe(["a"], count=-2.0)
    with pytest.raises(InputError, match="minimum"):
        Relations(minimum=np.nan)


@pytest.mark.parametrize("frame", ["cup", ["cup", 3], None])
def test_a_frame_is_several_words(frame: object) -> None:
    relations = Relations.from_frames(FRAMES)
    with pytest.raises(InputError, match="name"):
        relations.observe(frame)  # type: ignore[arg-type]
    assert relations.names == Relations.from_frames(FRAMES).names
    with pytest.raises(InputError, match="room"):
        relations.observe(["cup"], room=3)  # type: ignore[arg-type]


def test_labelme_annotations_are_counted_by_image(tmp_path: Path) -> None:
    for number in range(5):
        (tmp_path / f"{number}.xml").write_text(
            "<annotation><object><name>Bedstand</name><deleted>0</deleted></object>"
            "<object><name>lamp</name></object><object><name>cat</name><deleted>1</deleted></object></annotation>",
            encoding="utf-8",
        )
    (tmp_path / "other.json").write_text(
        '{"shapes": [{"label": "lamp"}, {"label": "bed"}]}', encoding="utf-8"
    )
    relations = Relations.from_labelme([tmp_path], synonyms={"bedstand": "nightstand"})
    assert relations.count("nightstand", "lamp") == 5.0
    assert "cat" not in relations
    # The node takes the folder as it is, with the synonyms that ship.
    node = ObjectSearchParameters(relations_file=str(tmp_path)).relations
    assert node.count("nightstand", "lamp") == 5.0
    # One image alone is an accident.
    assert relations.probability("bed", "lamp") == pytest.approx(0.5 / (6.0 + 1.5))
    (tmp_path / "broken.xml").write_text("<annotation>", encoding="utf-8")
    with pytest.raises(InputError, match="broken"):
        Relations.from_labelme([tmp_path])
    with pytest.raises(InputError, match="paths"):
        Relations.from_labelme([])
