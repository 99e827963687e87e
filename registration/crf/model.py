"""The joint model of data association, motion clustering and rigid motions between two scans, ready to use.

    model = JointModel.load()
    estimate = model.infer(scan_a, scan_b)     # estimate.clusters > 0 is what moves

Reference: joint reasoning about scan matching, moving objects and their motions by a conditional random field.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from estimation.boosting import AdaBoost
from estimation.errors import InputError
from estimation.gradient_boosting import GradientBoosting
from registration.crf.background import without_movers
from registration.crf.beams import beams_of
from registration.crf.estimate import JointEstimate, nothing, unchanged
from registration.crf.finish import confirmed, finish, standing
from registration.crf.inference import infer_labels
from registration.crf.potentials import WEIGHTS
from registration.crf.setup import Start, problem_of, start, starts_of
from registration.crf.verdict import Verdict, overruled
from registration.motion import Array
from registration.result import Registration
from registration.scan import Scan

FORMAT, VERSION = "whereabouts.joint_crf", 1
LEAST_RETURNS = 20


@dataclass(eq=False)
class JointModel:
    """Weights (23,) in the order of `potentials.WEIGHTS` and the two boosted classifiers of the local features.

    verdict : has the last word on what moves (`registration.crf.verdict`); without, the chains have it.
    """

    weights: Array
    data: AdaBoost | None = None
    outlier: AdaBoost | None = None
    card: dict[str, Any] = field(default_factory=dict)
    verdict: GradientBoosting | None = None
    _verdict: Verdict | None = field(default=None, init=False, repr=False)

    @classmethod
    def load(cls, path: str | Path | None = None) -> JointModel:
        """The model of `path`, or the one that is shipped.

        Raises
        ------
        InputError : the file is no such model.
        """
        if path is None:
            text = resources.files("registration.crf").joinpath("models/joint.json").read_text("utf-8")
        else:
            text = Path(path).read_text(encoding="utf-8")
        try:
            content = json.loads(text)
            if content["format"] != FORMAT or content["version"] != VERSION:
                raise InputError(f"path: {path} holds no {FORMAT} model of version {VERSION}")
            weights = np.array([content["weights"][name] for name in WEIGHTS])
            boosts = [AdaBoost.from_dict(content[name]) for name in ("data", "outlier")]
            told = content.get("verdict")
            verdict = None if told is None else GradientBoosting.from_dict(told)
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"path: {path} is no complete {FORMAT} model: {error}") from error
        return cls(weights, boosts[0], boosts[1], content.get("card", {}), verdict)

    def save(self, path: str | Path) -> None:
        """Write the model as readable JSON. InputError without boosted classifiers."""
        if self.data is None or self.outlier is None:
            raise InputError("model: not trained yet")
        content = {
            "format": FORMAT,
            "version": VERSION,
            "card": self.card,
            "weights": dict(zip(WEIGHTS, (float(value) for value in self.weights), strict=True)),
            "data": self.data.to_dict(),
            "outlier": self.outlier.to_dict(),
        }
        text = json.dumps(content, indent=1)
        if self.verdict is not None:
            # Thousands of numbers that nobody reads line by line.
            text = f'{text[:-2]},\n "verdict": {json.dumps(self.verdict.to_dict())}\n}}'
        Path(path).write_text(text + "\n", encoding="utf-8")

    def infer(
        self, scan_a: Scan, scan_b: Scan, registration: Registration | None = None, schedule: str = "exact"
    ) -> JointEstimate:
        """Who is who, what moves and how, between two scans of one place.

        registration : the motion that lays scan_a on scan_b, where it is known already. Their stamps, where they
            differ, bound how far a thing may have gone. schedule : one of `SCHEDULES`.

        Returns
        -------
        JointEstimate : never raises on poor data; `converged` is False and `reason` says why.
        """
        poor = _too_few(scan_a, scan_b)
        if poor is not None:
            return poor
        if registration is None and _same(scan_a, scan_b):
            return unchanged(scan_a.valid)
        return self._conclude(scan_a, scan_b, start(scan_a, scan_b, registration), schedule)

    def movers(
        self,
        scan_a: Scan,
        scan_b: Scan,
        registration: Registration,
        background: bool = True,
        known: JointEstimate | None = None,
    ) -> JointEstimate:
        """As `infer`, for who wants labels of what moves and knows from elsewhere how the sensor moved.

        The chains are asked only where something left its place: else all that agrees stands, and there are no
        associations.

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
        if begun.registration.converged and not begun.found and not begun.gone:
            return standing(begun)
        return self._conclude(scan_a, scan_b, begun, "exact", background)

    def _conclude(
        self, scan_a: Scan, scan_b: Scan, begun: Start, schedule: str, refined: bool = True
    ) -> JointEstimate:
        if not begun.registration.converged:
            return nothing(len(scan_a), begun.registration.reason)
        starts = starts_of(begun)
        problem = problem_of(begun, begun.motions, starts, self.data, self.outlier, self.weights)
        labelling = infer_labels(problem, self.weights, schedule)
        estimate = finish(begun, problem, labelling)
        if self.verdict is not None:
            if self._verdict is None or self._verdict.trees is not self.verdict:
                self._verdict = Verdict(self.verdict)
            estimate = overruled(estimate, begun, problem, self._verdict)
        if not refined:
            return estimate
        background = without_movers(
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
