"""Growing hidden Markov model over (position, intended position), sections 4.4.2 to 4.4.5 of the anchoring text.

Every state is a place of the topological map together with the place its person is going to. States of one intended
position form a manifold: no transition leaves it, so a belief over states is a belief over where somebody is heading.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.checks import FloatArray
from tracking.intentions.ghmm_kernels import expected_counts, forward, log_observation, propagate, weigh
from tracking.intentions.intention_config import IntentionConfig
from tracking.prediction.topological_map import MapChanges, TopologicalMap

IntArray = NDArray[np.int64]
# Manifolds whose goal explains the end of a trajectory this much worse than the best are left out of its update.
GOAL_MARGIN = 25.0


class GrowingHmm:
    """Structure and parameters λ = {π, A, b} of (4.1), learned one trajectory at a time.

    The states live on the topological map `places`, which this class feeds. A new edge, and staying in a new state, has
    the transition probability a_0 of the settings. The text averages parameters without a limit, here over `memory`
    trajectories.
    """

    def __init__(self, config: IntentionConfig) -> None:
        self.config = config
        self.places = TopologicalMap(config.resolution, config.window)
        self.learned = 0
        self.node: IntArray = np.zeros(0, dtype=np.int64)
        self.goal: IntArray = np.zeros(0, dtype=np.int64)
        self.prior: FloatArray = np.zeros(0)
        self.successors: IntArray = np.zeros((0, 8), dtype=np.int64)
        self.transitions: FloatArray = np.zeros((0, 8))
        self._index: dict[tuple[int, int], int] = {}
        self._precisions: FloatArray = np.zeros((0, 4))

    def __len__(self) -> int:
        return len(self.node)

    @property
    def edge_count(self) -> int:
        """Transitions that are not zero, staying included."""
        return int((self.successors >= 0).sum())

    @property
    def goals(self) -> IntArray:
        """Nodes that are an intended position, ascending."""
        return np.unique(self.goal)

    def learn(self, points: FloatArray) -> float:
        """Update map, structure and parameters from one finished trajectory (T, 2); log p(O | λ) before the update."""
        changes = self.places.insert(points)
        visited = self.places.nearest(points)
        self._follow_map(changes)
        self._follow_edges(changes)
        self._grow(visited)
        self._observe_anew(np.unique(visited))
        self._renumber()
        self.learned += 1
        self._normalise()
        return self._re_estimate(points)

    # Belief, (4.11) and (4.12).

    def log_observations(self, points: FloatArray) -> FloatArray:
        """log p(O_k | S) per node of the map, (T, nodes)."""
        return np.asarray(log_observation(points, self.places.positions, self._precisions))

    def start(self, point: FloatArray) -> FloatArray:
        """Belief (S,) after the first observation (2,)."""
        return self._weigh(self.prior, point)

    def update(self, belief: FloatArray, point: FloatArray) -> FloatArray:
        """Belief (S,) one observation (2,) later; where no transition explains it, the person is found anew."""
        return self._weigh(propagate(belief, self.successors, self.transitions), point)

    def belief(self, points: FloatArray) -> FloatArray:
        """Belief (S,) after the observations (T, 2)."""
        belief = self.start(points[0])
        for point in points[1:]:
            belief = self.update(belief, point)
        return belief

    def intentions(self, belief: FloatArray) -> tuple[IntArray, FloatArray]:
        """(4.12): goal nodes (G,) and their probabilities (G,), the most probable first."""
        goals, index = np.unique(self.goal, return_inverse=True)
        probabilities = np.bincount(index, belief, len(goals)).astype(np.float64)
        order = np.argsort(-probabilities, kind="stable")
        return goals[order], probabilities[order]

    def _weigh(self, predicted: FloatArray, point: FloatArray) -> FloatArray:
        log_b = self.log_observations(point[None])[0]
        belief, log_z = weigh(predicted, log_b, self.node)
        if np.isfinite(log_z):
            return np.asarray(belief)
        return np.asarray(weigh(self.prior, log_b, self.node)[0])

    def move(self, moved: Callable[[FloatArray], FloatArray]) -> None:
        """Take map and observation probabilities to another frame."""
        self.places.move(moved)
        self._observe_anew(self.places.nodes)

    def as_arrays(self) -> dict[str, NDArray[Any]]:
        """States, parameters and count, for storage; the map is stored on its own."""
        return {
            "node": self.node,
            "goal": self.goal,
            "prior": self.prior,
            "successors": self.successors,
            "transitions": self.transitions,
            "learned": np.array(self.learned),
        }

    def from_arrays(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Take over what `as_arrays` gave; the map must be there already."""
        self.node, self.goal = arrays["node"].astype(np.int64), arrays["goal"].astype(np.int64)
        self.prior, self.learned = arrays["prior"].astype(np.float64), int(arrays["learned"])
        self.successors = arrays["successors"].astype(np.int64)
        self.transitions = arrays["transitions"].astype(np.float64)
        count = len(self.node)
        shapes = {len(self.goal), len(self.prior), len(self.successors), len(self.transitions)}
        if shapes != {count} or (count and self.successors.max() >= count):
            raise ValueError("states do not fit together")
        self._index_states()
        self._precisions = np.zeros((0, 4))
        self._observe_anew(self.places.nodes)

    # Structure, section 4.4.3.

    def _follow_map(self, changes: MapChanges) -> None:
        """States of places that are gone go; of places that were merged they move over."""
        if changes.merged or changes.removed:
            target = np.arange(self.places.size)
            for gone, kept in changes.merged:
                target[target == gone] = kept
            self.node, self.goal = target[self.node], target[self.goal]
            alive = np.isfinite(self.places.positions[:, 0])
            keep = alive[self.node] & alive[self.goal]
            self._index = {}
            for s in np.flatnonzero(keep).tolist():
                key = (int(self.node[s]), int(self.goal[s]))
                if key in self._index:
                    self.prior[self._index[key]] += self.prior[s]
                    keep[s] = False
                else:
                    self._index[key] = s
            self._keep(keep)
        self._drop_edges()

    def _index_states(self) -> None:
        pairs = zip(self.node.tolist(), self.goal.tolist(), strict=True)
        self._index = {pair: s for s, pair in enumerate(pairs)}

    def _keep(self, keep: NDArray[np.bool_]) -> None:
        """Drop states; transitions to them are dropped too."""
        number = np.full(len(keep) + 1, -1, dtype=np.int64)
        number[:-1][keep] = np.arange(int(keep.sum()))
        self.node, self.goal, self.prior = self.node[keep], self.goal[keep], self.prior[keep]
        self.successors, self.transitions = number[self.successors[keep]], self.transitions[keep]
        self._index_states()

    def _renumber(self) -> None:
        """Give the numbers of places that are gone free again."""
        if self.places.size == len(self.places):
            return
        number = self.places.compact()
        kept = np.flatnonzero(number >= 0)
        self.node, self.goal = number[self.node], number[self.goal]
        self._precisions = self._precisions[kept]
        self._index_states()

    def _drop_edges(self) -> None:
        """Transitions along edges that the map no longer has become zero; rows are packed to the left."""
        size = self.places.size
        edges = np.array(self.places.edges, dtype=np.int64).reshape(-1, 2)
        known = np.concatenate((edges[:, 0] * size + edges[:, 1], edges[:, 1] * size + edges[:, 0]))
        there = self.successors >= 0
        if len(self.node):
            start, end = np.broadcast_to(self.node[:, None], there.shape), self.node[self.successors]
            there &= (start == end) | np.isin(start * size + end, known)
        order = np.argsort(~there, axis=1, kind="stable")
        self.successors = np.take_along_axis(np.where(there, self.successors, -1), order, axis=1)
        self.transitions = np.take_along_axis(np.where(there, self.transitions, 0.0), order, axis=1)

    def _follow_edges(self, changes: MapChanges) -> None:
        """New edges of the map join the states of every manifold that has both ends."""
        of_node: dict[int, list[int]] = {}
        for s, node in enumerate(self.node.tolist()):
            of_node.setdefault(node, []).append(s)
        for a, b in changes.linked:
            if b not in self.places.neighbours.get(a, ()):
                continue
            for i in of_node.get(a, []):
                j = self._index.get((b, int(self.goal[i])))
                if j is not None:
                    for start, end in ((i, j), (j, i)):
                        if end not in self.successors[start]:
                            self._connect(start, end)

    def _grow(self, visited: IntArray) -> None:
        """New states for the places of a trajectory, heading for its last one, and their transitions."""
        goal = int(visited[-1])
        fresh = [n for n in dict.fromkeys(visited.tolist()) if (n, goal) not in self._index]
        count, width = len(self.node), self.successors.shape[1]
        self.node = np.concatenate((self.node, np.array(fresh, dtype=np.int64)))
        self.goal = np.concatenate((self.goal, np.full(len(fresh), goal, dtype=np.int64)))
        # Priors sum to one over all trajectories so far: π_0 is meant for one of them. Taken as it stands, a walk
        # through a dozen new places would halve what all walks before it have taught.
        first = self.config.initial_prior / (self.learned + 1)
        self.prior = np.concatenate((self.prior, np.full(len(fresh), first)))
        self.successors = np.concatenate((self.successors, np.full((len(fresh), width), -1)))
        self.transitions = np.concatenate((self.transitions, np.zeros((len(fresh), width))))
        self._index |= {(n, goal): count + k for k, n in enumerate(fresh)}
        for s in np.flatnonzero(self.goal == goal).tolist():
            node = int(self.node[s])
            known = set(self.successors[s].tolist())
            for linked in (node, *sorted(self.places.neighbours[node])):
                j = self._index.get((linked, goal))
                if j is not None and j not in known:
                    self._connect(s, j)

    def _connect(self, i: int, j: int) -> None:
        free = int((self.successors[i] >= 0).sum())
        if free == self.successors.shape[1]:
            self.successors = np.pad(self.successors, ((0, 0), (0, 4)), constant_values=-1)
            self.transitions = np.pad(self.transitions, ((0, 0), (0, 4)))
        self.successors[i, free], self.transitions[i, free] = j, self.config.initial_transition

    # Observation probabilities, section 4.4.2.

    def _observe_anew(self, nodes: IntArray) -> None:
        missing = self.places.size - len(self._precisions)
        if missing > 0:
            self._precisions = np.concatenate((self._precisions, np.tile([1.0, 0.0, 1.0, 0.0], (missing, 1))))
        for node in nodes.tolist():
            covariance = self.places.covariance(node, self.config.spread, self.config.noise**2)
            inverse = np.linalg.inv(covariance)
            self._precisions[node] = *inverse[0], inverse[1, 1], np.linalg.slogdet(covariance)[1]

    # Parameters, section 4.4.4.

    def _normalise(self) -> None:
        """Step 1: priors and transitions sum to one again."""
        self.prior = self.prior / self.prior.sum()
        totals = self.transitions.sum(axis=1, keepdims=True)
        self.transitions = self.transitions / np.where(totals > 0.0, totals, 1.0)

    def _re_estimate(self, points: FloatArray) -> float:
        """Steps 2 to 4: expected counts on the manifolds that end where the trajectory did, averaged in."""
        log_b = self.log_observations(points)
        of_goals = log_b[-1][self.goal]
        members = np.flatnonzero(of_goals > of_goals.max() - GOAL_MARGIN)
        number = np.full(len(self.node) + 1, -1, dtype=np.int64)
        number[members] = np.arange(len(members))
        successors, transitions = number[self.successors[members]], self.transitions[members]
        nodes = self.node[members]
        # The augmented observation (4.10): the goal's part is the same at every step and only weighs manifolds.
        prior = self.prior[members] * np.exp(of_goals[members] - of_goals.max())
        alpha, scales = forward(prior, successors, transitions, log_b, nodes)
        if not np.isfinite(scales).all():
            return float("-inf")
        first, xi = expected_counts(alpha, scales, successors, transitions, log_b, nodes)
        rate = 1.0 / min(self.learned, self.config.memory)
        estimate = np.zeros(len(self.node))
        estimate[members] = first
        self.prior = (1.0 - rate) * self.prior + rate * estimate
        leaving = xi.sum(axis=1, keepdims=True)
        renewed = (1.0 - rate) * transitions + rate * xi / np.where(leaving > 0.0, leaving, 1.0)
        self.transitions[members] = np.where(leaving > 1e-9, renewed, transitions)
        return float(scales.sum())
