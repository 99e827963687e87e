"""Where people are going: learned intended positions joined with social forces (chapter 4 of the anchoring text).

model = IntentionModel()
model.learn(trajectory)                           # (N, 3) x, y, t of a walk that has ended
prediction = model.predict(partial, horizon=5.0, others=[another], obstacles=points)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from estimation.checks import FloatArray, as_floats, require_kind, require_positive, require_within
from estimation.errors import InputError
from tracking.intentions.ghmm import GrowingHmm
from tracking.intentions.intention_config import IntentionConfig
from tracking.intentions.intention_storage import read, write
from tracking.intentions.observations import FASTEST, SLOWEST, clean, spaced
from tracking.intentions.path_errors import LAGS, PathErrors, squared_rates
from tracking.intentions.prediction import PredictedWay, Prediction, parse_others, path_covariances
from tracking.intentions.routes import RouteBelief, Routes
from tracking.intentions.walking_motion import WALKING, WalkingMotion, estimate
from tracking.prediction.social_forces import Forces, Obstacles, Walker, simulate

# Only a goal that is nearly certain stops a path; this power of its probability fits the hotel's people.
ARRIVAL = 4
# Way points closer than this to the person are behind it before it can turn to them.
LOOK_AHEAD = 2.0
# Somebody not seen for longer than this is taken to be where this time has led, s.
MISSING = 5.0
WAY_SPACING = 1.0
# Shares of a finished walk from which it is predicted, to learn how far off predictions are.
JUDGED = (0.2, 0.4, 0.6, 0.8)
# Between two observations of one walk, m: what lies further apart is a tracker's or a frame's mistake.
WIDEST_GAP = 100.0
LONGEST = 3600.0  # s that are predicted at most; more is milliseconds taken for seconds


@dataclass(frozen=True)
class LearnedIntentions:
    """What came of a trajectory: whether it taught something, why not, and rows that were left out by reason."""

    taken: bool
    reason: str = ""
    dropped: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class _Person:
    motion: WalkingMotion
    belief: RouteBelief
    ways: list[FloatArray]

    @property
    def stamp(self) -> float:
        return float(self.motion.rows[-1, 2])

    def state(self, now: float) -> FloatArray:
        """(4,) x, y, vx, vy at `now` s: gone on as last seen, for MISSING s at most."""
        state = self.motion.state.copy()
        state[:2] += np.clip(now - self.stamp, -MISSING, MISSING) * state[2:]
        return state


class IntentionModel:
    """Learns from finished trajectories and predicts partial ones; all in one frame, metres and seconds.

    learned : trajectories that taught something.
    hmm : the growing hidden Markov model, which learns with methods "ghmm" and "printed".
    routes : the learned walks, which are kept with method "routes".
    errors : how far people were from predicted paths.
    """

    _others: ClassVar[dict[str, type[IntentionModel]]] = {}

    def __init_subclass__(cls, method: str) -> None:
        """Another model, of a method by its name."""
        cls._others[method] = cls

    def __init__(self, config: IntentionConfig | None = None) -> None:
        self.config = IntentionConfig() if config is None else config
        require_kind("config", self.config, IntentionConfig)
        self.forces = Forces(**{name: getattr(self.config, name) for name in Forces.__dataclass_fields__})
        self.reset()

    def reset(self) -> None:
        """Forget everything that was learned."""
        self.hmm = GrowingHmm(self.config)
        self.routes = Routes(self.config.routes)
        self.errors = PathErrors((self.config.speed_sigma, self.config.course_sigma), self.config.memory)
        self.learned = 0

    @staticmethod
    def of(config: IntentionConfig) -> IntentionModel:
        """The model of `config.method`: "printed" has the text's own paths."""
        return IntentionModel._others.get(config.method, IntentionModel)(config)

    def learn(self, trajectory: ArrayLike) -> LearnedIntentions:
        """Learn from one finished trajectory (N, 3) x, y, t.

        Rows that are not finite, repeat a time, run back in time or jump away and back are left out; gaps, loops and
        jumps that last are taken as they are, unless one is wider than any room. A person that stayed within
        `min_length` teaches nothing, and neither does what is mostly faster than people are, or always slower.
        Raises InputError: not (N, 3), or without one finite row.
        """
        cleaned = clean("trajectory", trajectory)
        dropped = cleaned.dropped
        points = np.ascontiguousarray(cleaned.rows[:, :2])
        if len(points) < 2:
            return LearnedIntentions(False, "one observation", dropped)
        if float(np.hypot(*np.ptp(points, axis=0))) < self.config.min_length:
            return LearnedIntentions(False, f"stayed within {self.config.min_length:g} m", dropped)
        steps = np.diff(cleaned.rows, axis=0)
        lengths = np.hypot(steps[:, 0], steps[:, 1])
        speeds = lengths / steps[:, 2]
        if float(np.median(speeds)) > FASTEST:
            return LearnedIntentions(False, "faster than people are: metres and seconds expected", dropped)
        if float(speeds.max()) < SLOWEST:
            return LearnedIntentions(False, "slower than people are: metres and seconds expected", dropped)
        if float(lengths.max()) > WIDEST_GAP:
            return LearnedIntentions(False, f"a gap of {lengths.max():.3g} m", dropped)
        self._judge(cleaned.rows)
        if self.config.method == "routes":
            self.routes.learn(cleaned.rows)
        else:
            self.hmm.learn(self._thinned(points))
        self.learned += 1
        return LearnedIntentions(True, "", dropped)

    def predict(
        self,
        partial: ArrayLike,
        horizon: float,
        others: ArrayLike | Sequence[ArrayLike] | None = None,
        obstacles: ArrayLike | Obstacles | None = None,
    ) -> Prediction:
        """Where the person seen along `partial` (N, 3) x, y, t will go within `horizon` s.

        others : people present at the same time, who are predicted too and get out of each other's way: a sequence of
            (M, 3) partial trajectories, or an array (P, 4) x, y, vx, vy or (P, 2) of people who stand.
        obstacles : (K, 2) m, or `Obstacles` made from them once.
        Raises InputError: shapes other than these, no finite row, or a horizon that is not above zero or over an hour.
        """
        beside, states = parse_others(others)
        return self._predict([partial, *beside], states, horizon, obstacles, 1)[0]

    def predict_all(
        self, partials: Sequence[ArrayLike], horizon: float, obstacles: ArrayLike | Obstacles | None = None
    ) -> list[Prediction]:
        """Predictions of all people present, (N, 3) each, each taking the others into account.

        All paths begin at the newest observation of anybody; who was last seen earlier has gone on as then.
        """
        return self._predict(list(partials), np.zeros((0, 4)), horizon, obstacles, len(partials))

    def intentions(self, partial: ArrayLike, horizon: float = 5.0) -> tuple[FloatArray, FloatArray]:
        """Goals (G, 2) and their probabilities (G,) alone, as `Prediction` has them: (4.12)."""
        belief = self._believe(self._motion(clean("partial", partial).rows), horizon)
        return belief.goals, belief.probabilities

    def move(self, pose: ArrayLike) -> None:
        """Move everything that was learned by `pose` (3,) x, y, yaw: m, rad, from the old frame of the map to the new.

        Intended positions belong to a map; where the map is corrected or joined to another, they go with it.
        """
        given = as_floats("pose", pose)
        if given.shape != (3,) or not np.isfinite(given).all():
            raise InputError(f"pose must be three finite numbers x, y, yaw, not {pose!r}")
        cosine, sine = np.cos(given[2]), np.sin(given[2])
        rotation = np.array([[cosine, -sine], [sine, cosine]])

        def moved(points: FloatArray) -> FloatArray:
            return np.asarray(points @ rotation.T + given[:2])

        self.routes.move(moved)
        self.hmm.move(moved)

    def save(self, path: Path | str, map_id: str = "") -> Path:
        """Write what was learned, whole or not at all; `map_id` names the map its frame belongs to.

        Returns the path. Raises InputError: the folder does not exist or may not be written.
        """
        about = {"map_id": map_id, "learned": self.learned, "config": asdict(self.config)}
        return write(Path(path), about, self._parts())

    @classmethod
    def load(cls, path: Path | str, map_id: str | None = None) -> IntentionModel:
        """Read what was saved. With `map_id` it must be of that map.

        Raises InputError: no such file, not a saved model, of another version or map, or damaged.
        """
        stored = read(Path(path), map_id)
        with stored.filling():
            model = cls.of(IntentionConfig(**stored.about["config"]))
            model.learned = int(stored.about["learned"])
            for prefix, part in model._parts().items():
                part.from_arrays(stored.part(prefix))
        return model

    def _parts(self) -> dict[str, Any]:
        """What is stored, by the beginnings of its arrays' names; the states of `hmm` need its map."""
        return {"places_": self.hmm.places, "hmm_": self.hmm, "routes_": self.routes, "errors_": self.errors}

    def warm_up(self) -> None:
        """Compile what learning and predicting run, before the first person is there. Nothing is learned."""
        scratch = self.of(self.config)
        t = np.arange(0.0, 4.0, 0.2)
        walk = np.column_stack((t, 0.1 * t, t))
        for _ in range(2):
            scratch.learn(walk)
        scratch.predict_all([walk[:10], walk[:12] + 1.0], 1.0, np.array([[2.0, 2.0]]))

    # Below: one prediction from belief to paths.

    def _judge(self, rows: FloatArray) -> None:
        """Predict a finished walk (N, 3) from several moments, as if it went on, and learn how far off that is."""
        judged, missed = [], []
        for share in JUDGED:
            seen = int(np.searchsorted(rows[:, 2], rows[0, 2] + share * (rows[-1, 2] - rows[0, 2]), "right"))
            told = self._predict([rows[:seen]], np.zeros((0, 4)), LAGS[-1], None, 1)[0]
            ways = [PredictedWay(0, told.path, told.covariances), *told.alternatives]
            chances = told.probabilities[[way.goal for way in ways]]
            squares, motion = squared_rates(ways, chances, rows[seen - 1 :]), self._motion(rows[:seen])
            # What is told besides is not to be learned as well.
            known = np.square(self.config.position_sigma / np.array(LAGS[: len(squares)])) + motion.variance
            judged.append((motion.speed > WALKING, squares - known[:, None]))
            off = np.hypot(*(told.goals - rows[-1, :2]).T)
            missed.append(bool(off.min() > self.config.goal_radius))
        self.errors.learn(judged, float(np.mean(missed)))

    def _thinned(self, points: FloatArray) -> FloatArray:
        """Observations half a node apart: closer ones say the same again, and would be counted as if they did not."""
        return spaced(points, 0.5 * self.config.resolution)

    def _motion(self, rows: FloatArray) -> WalkingMotion:
        return estimate(rows, self.config.velocity_memory, self.config.manoeuvre)

    def _believe(self, motion: WalkingMotion, horizon: float) -> RouteBelief:
        rows = motion.rows
        points = np.ascontiguousarray(rows[:, :2])
        if self.config.method == "routes" or not len(self.hmm):
            reach = max(motion.speed * horizon, 0.1)
            return self.routes.believe(rows, reach, self.config.goal_radius, self.config.max_goals)
        nodes, probabilities = self.hmm.intentions(self.hmm.belief(self._thinned(points)))
        few = slice(self.config.max_goals)
        total = probabilities[few].sum()
        goals = self.hmm.places.positions[nodes[few]]
        return RouteBelief(goals, probabilities[few] / total, 0.0, [None] * len(goals))

    @staticmethod
    def _tracks(partials: list[ArrayLike], horizon: float) -> list[FloatArray]:
        """Cleaned rows (N, 3) of the one predicted and the others; InputError also for a horizon that is none."""
        require_within("horizon", require_positive("horizon", horizon), 0.0, LONGEST)
        names = ["partial", *(f"others[{k}]" for k in range(len(partials) - 1))]
        return [clean(name, partial).rows for name, partial in zip(names, partials, strict=False)]

    def _person(self, rows: FloatArray, horizon: float) -> _Person:
        motion = self._motion(rows)
        belief = self._believe(motion, horizon)
        ways = [self._way(belief, g, motion) for g in range(min(len(belief.goals), self.config.alternatives))]
        return _Person(motion, belief, ways)

    def _way(self, belief: RouteBelief, goal: int, motion: WalkingMotion) -> FloatArray:
        """Points to pass on the way to a goal: those of the walk that leads there, as far as it lies ahead."""
        lead = belief.leads[goal]
        end = belief.goals[goal][None]
        if lead is None:
            # A place of the plain model is where people stop; straight on only passes the point that stands for it.
            known = self.config.method == "ghmm" and len(self.hmm) > 0
            return end if known else 2.0 * end - motion.state[:2]
        rest = spaced(self.routes.rest(lead), WAY_SPACING)[:-1]
        away = np.hypot(*(rest - motion.state[:2]).T)
        to_end = np.hypot(*(rest - end).T)
        ahead = np.flatnonzero(away < LOOK_AHEAD)
        first = int(ahead[-1]) + 1 if len(ahead) else 0
        return np.concatenate((rest[first:][to_end[first:] > WAY_SPACING], end))

    def _predict(
        self,
        partials: list[ArrayLike],
        states: FloatArray,
        horizon: float,
        obstacles: ArrayLike | Obstacles | None,
        wanted: int,
    ) -> list[Prediction]:
        around = obstacles if isinstance(obstacles, Obstacles) else Obstacles(obstacles)
        people = [self._person(rows, horizon) for rows in self._tracks(partials, horizon)]
        passing = [Walker(state) for state in states]
        most = max((len(person.ways) for person in people[:wanted]), default=0)
        now = max((person.stamp for person in people[:wanted]), default=0.0)
        runs = []
        for rank in range(most):
            walkers = [self._walker(person, min(rank, len(person.ways) - 1), now) for person in people]
            runs.append(simulate([*walkers, *passing], horizon, self.forces, around, self.config.time_step))
        return [
            self._told(person, [run[:, k] for run in runs], horizon, now)
            for k, person in enumerate(people[:wanted])
        ]

    def _walker(self, person: _Person, rank: int, now: float) -> Walker:
        motion, c = person.motion, self.config
        pace = motion.speed
        if c.pace_weight > 0.0 and motion.pace > 0.0:
            pace += c.pace_weight * (motion.pace - motion.speed)
        # One who stands goes on standing; nobody is drawn to a goal harder than the goal is sure.
        trust = float(person.belief.probabilities[rank]) if c.method == "routes" else 1.0
        relaxation = self.forces.relaxation / max(trust * (1.0 - person.belief.novelty), 1e-6)
        return Walker(person.state(now), person.ways[rank], pace, relaxation, max(trust**ARRIVAL, 1e-6))

    def _told(self, person: _Person, runs: list[FloatArray], horizon: float, now: float) -> Prediction:
        belief = person.belief
        after = np.linspace(0.0, horizon, len(runs[0]))
        unseen = now - person.stamp + after
        motion = person.motion
        rates = np.sqrt(np.square(self.errors.rates(motion.speed > WALKING, unseen)) + motion.variance)
        ways = []
        for rank in range(len(person.ways)):
            path = np.column_stack((runs[rank][:, :2], now + after))
            covariances = path_covariances(self.config.position_sigma, rates, unseen, runs[rank])
            ways.append(PredictedWay(rank, path, covariances))
        first = ways[0]
        return Prediction(
            goals=belief.goals,
            probabilities=belief.probabilities,
            path=first.path,
            covariances=first.covariances,
            alternatives=ways[1:],
            novelty=belief.novelty,
            elsewhere=self.errors.elsewhere,
        )
