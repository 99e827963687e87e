"""The cat and the clean-up of section 3.8, against what the text says of them."""

import numpy as np

from evaluation.maintenance import maintenance_scenes as scenes


def test_the_cat_is_looked_at_less_often_where_it_is_measured_worse():
    scene = scenes.film(0)
    blurred = scenes.Film(scene.positions, 9.0 * scene.variances)
    sharp, dull = (scenes.watch(each, 0).rates()[0] for each in (scene, blurred))
    assert 0 < dull < sharp < 30


def test_a_camera_that_cannot_be_moved_looks_as_the_printed_rule_does():
    scene = scenes.film(1)
    np.testing.assert_array_equal(scenes.watch(scene, 1).looks, scenes.watch(scene, 1, ours=True).looks)


def test_clearing_a_room_goes_as_in_the_text():
    for seed in range(3):
        done = scenes.clean_up(seed)
        assert [who for who, _, _ in done] == [stage.theirs for stage in scenes.STAGES]


def test_a_look_before_grabbing_helps():
    looked = [each for seed in range(20) for each in scenes.clean_up(seed) if each[0] != "nobody"]
    before, after = np.mean([each[1:] for each in looked], axis=0)
    assert after < 0.5 * before
