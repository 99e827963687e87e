"""Data association, moving objects and their motions between two scans, ready to use.

    model = JointModel.load()
    estimate = model.infer(scan_a, scan_b)     # estimate.clusters > 0 is what moves

Registration, then groups of points that do not follow it (`setup`), then boosted trees that decide per beam.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.checks import require_kind
from estimation.errors import InputError
from estimation.geometry.poses import between
from estimation.learning.gradient_boosting import GradientBoosting
from registration.crf.beams import beams_of
from registration.crf.estimate import JointEstimate, nothing, read_model, unchanged
from registration.crf.labels import confirmed, estimate_of, groups_as_labels
from registration.crf.setup import Start, start
from registration.crf.trees import decided
from registration.laser.prepared import prepared
from registration.laser.scan import Scan
from registration.placement.align import agreements
from registration.placement.judgement import LENIENT, judged
from registration.placement.refine import refine
from registration.result import Registration

FORMAT, VERSION = "whereabouts.moving_beams", 1
LEAST_RETURNS = 20
DOUBT = 0.08  # metres, how far what stands may still lie off
MOST = 0.1  # metres and radians the motion may change by; more is another answer, not a better one


@dataclass(eq=False)
class JointModel:
    """What says who is who, what moves and how.

    trees : decide what moves (`registration.crf.trees`); without, the groups do.
    """

    trees: GradientBoosting | None = None
    card: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def load(cls, path: str | Path | None = None) -> JointModel:
        """The model of `path`, or the one that is shipped.

        Raises
        ------
        InputError : the file is no such model.
        """
        return read_model(
            path, "movers.json", FORMAT, VERSION,
            lambda content: cls(GradientBoosting.from_dict(content["trees"]), content.get("card", {})),
        )  # fmt: skip

    def save(self, path: str | Path) -> None:
        """Write the model as JSON. InputError without trees."""
        if self.trees is None:
            raise InputError("model: not trained yet")
        head = json.dumps({"format": FORMAT, "version": VERSION, "card": self.card}, indent=1)
        # Thousands of numbers that nobody reads line by line.
        text = f'{head[:-2]},\n "trees": {json.dumps(self.trees.to_dict())}\n}}\n'
        Path(path).write_text(text, encoding="utf-8")

    def infer(self, scan_a: Scan, scan_b: Scan, registration: Registration | None = None) -> JointEstimate:
        """Who is who, what moves and how, between two scans of one place.

        registration : the motion that lays scan_a on scan_b, where it is known already. Their stamps, where they
            differ, bound how far a thing may have gone.

        Returns
        -------
        JointEstimate : never raises on poor data; `converged` is False and `reason` says why.
        """
        for name, scan in (("scan_a", scan_a), ("scan_b", scan_b)):
            require_kind(name, scan, Scan)
        if registration is not None:
            require_kind("registration", registration, Registration)
        poor = _too_few(scan_a, scan_b)
        if poor is not None:
            return poor
        if registration is None and _same(scan_a, scan_b):
            return unchanged(scan_a.valid)
        return self.conclude(scan_a, scan_b, start(scan_a, scan_b, registration))

    def movers(
        self, scan_a: Scan, scan_b: Scan, registration: Registration, background: bool = True,
        known: JointEstimate | None = None,
    ) -> JointEstimate:  # fmt: skip
        """As `infer`, for who wants labels of what moves and knows from elsewhere how the sensor moved.

        background : whether its motion is to be refined without what moves.
        known : what another pair said of scan_a; where this one shows nothing else to have left its place, it
            confirms that, and says nothing of motions.
        """
        poor = _too_few(scan_a, scan_b)
        if poor is not None:
            return poor
        begun = start(scan_a, scan_b, registration, True, None if known is None else known.moving)
        if begun.again is not None and known is not None:
            return confirmed(begun, begun.again, known)
        return self.conclude(scan_a, scan_b, begun, background)

    def conclude(self, scan_a: Scan, scan_b: Scan, begun: Start, refined: bool = True) -> JointEstimate:
        """As `infer`, from a start that was made already; refined : see `background` of `movers`."""
        if not begun.registration.converged:
            return nothing(len(scan_a), begun.registration.reason)
        labels = groups_as_labels(begun)
        probability = (labels > 0).astype(np.float64)
        if self.trees is not None:
            labels, probability = decided(begun, labels, self.trees)
        estimate = estimate_of(begun, labels, probability)
        if refined:
            background = _without_movers(
                scan_a, scan_b, begun.registration, estimate.associations, estimate.moving
            )
            estimate.motions[0], estimate.covariances[0] = background.transform, background.covariance
        return estimate


def _too_few(scan_a: Scan, scan_b: Scan) -> JointEstimate | None:
    count = min(len(beams_of(scan_a)), len(beams_of(scan_b)))
    if count < LEAST_RETURNS:
        return nothing(len(scan_a), f"{count} returns, {LEAST_RETURNS} are needed")
    return None


def _same(scan_a: Scan, scan_b: Scan) -> bool:
    """Whether two scans are one reading: drivers repeat themselves, and nothing has moved then."""
    angles = (scan_a.angle_min, scan_a.angle_increment) == (scan_b.angle_min, scan_b.angle_increment)
    return angles and np.array_equal(
        np.where(scan_a.valid, scan_a.ranges, 0.0), np.where(scan_b.valid, scan_b.ranges, 0.0)
    )


def _without_movers(
    scan_a: Scan,
    scan_b: Scan,
    registration: Registration,
    associations: NDArray[np.int64],
    moving: NDArray[np.bool_],
) -> Registration:
    """`registration` refined without the beams of scan_a that move, (N,), and their partners in scan_b."""
    if not moving.any():
        return registration
    left = np.zeros(len(scan_b), dtype=bool)
    left[associations[moving & (associations >= 0)]] = True
    rest = prepared(scan_a).without(moving[scan_a.valid])
    target = prepared(scan_b).without(left[scan_b.valid])
    refined = refine(rest.surface, target.target, registration.transform.copy(), DOUBT)
    if (
        not refined.settled
        or refined.open_directions
        or np.abs(between(registration.transform, refined.pose)).max() > MOST
    ):
        return registration
    found = judged(
        rest, target, refined, registration.transform, agreements(rest, target, refined.pose), LENIENT
    )
    return found if found.converged else replace(registration, transform=refined.pose)
