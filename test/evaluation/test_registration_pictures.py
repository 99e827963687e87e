"""What the pictures of range data draw: ellipses by (2.9) and (2.10), against drawn measurements and text."""

from pathlib import Path

import numpy as np
import pytest

from estimation.conversion.polar import convert
from evaluation.registration.registration_pictures import (
    MEASURED,
    UNSURE,
    cartesian,
    draw_uncertainty,
    ellipse,
    noise_of,
)


def test_first_order_is_near_what_drawn_measurements_show() -> None:
    rng = np.random.default_rng(1)
    drawn = cartesian(np.array(MEASURED) + rng.normal(size=(200_000, 2)) * UNSURE)
    mean, covariance = convert(*MEASURED, *UNSURE, method="linear")
    np.testing.assert_allclose(np.cov(drawn.T), covariance, atol=0.01)
    inside = np.einsum("ni,ij,nj->n", drawn - mean, np.linalg.inv(covariance), drawn - mean) < 9.0
    assert inside.mean() == pytest.approx(1.0 - np.exp(-4.5), abs=0.005)


def test_an_ellipse_is_so_many_deviations_away() -> None:
    covariance = np.array([[2.0, 0.7], [0.7, 0.5]])
    off = ellipse(np.array([1.0, 2.0]), covariance, 3.0) - [1.0, 2.0]
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", off, np.linalg.inv(covariance), off), 9.0)


def test_noise_doubles_at_the_farthest_range() -> None:
    """(2.10): 0.01 m and 0.01 degrees, times 1 + r / r_max."""
    sigmas = noise_of(np.array([0.0, 40.0]), 40.0)
    np.testing.assert_allclose(sigmas[0], [0.01, 0.02])
    np.testing.assert_allclose(np.degrees(sigmas[1]), [0.01, 0.02])


def test_the_picture_is_written(tmp_path: Path) -> None:
    assert draw_uncertainty(tmp_path).stat().st_size > 0
