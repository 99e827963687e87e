"""How fast the position of each object grows uncertain, seen from outside: from one world state to the next."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from world_model.state import MOVED_ON, WorldState

ELSEWHERE = 1.0  # m: standard deviation of what has probably gone somewhere else; one look tells


@dataclass
class _Track:
    """Last state of one object: its last measurement and that state's stamp, s; variance, m²; growth, m²/s."""

    last_seen: float
    stamp: float
    variance: float
    rate: float


class Growth:
    """Estimates process noise for consumers that only see messages.

    default : m²/s, for objects that have not been watched while nobody looked at them, and the least there is for
    drives: what rests in the world model may have been carried away since it was seen, though it sees no reason why.
    """

    def __init__(self, default: float) -> None:
        self._default = default
        self._tracks: dict[str, _Track] = {}

    def observe(self, state: WorldState) -> None:
        """Take in a state; objects that are gone are forgotten."""
        tracks = {}
        for item in state.objects:
            variance = float(np.trace(item.covariance)) / len(item.covariance)
            track = self._tracks.get(item.id)
            rate = self._default if track is None else track.rate
            if track is not None and track.last_seen == item.last_seen and state.stamp > track.stamp:
                rate = max((variance - track.variance) / (state.stamp - track.stamp), 0.0)
            tracks[item.id] = _Track(item.last_seen, state.stamp, variance, rate)
        self._tracks = tracks

    def ahead(self, state: WorldState, stamp: float, carried: bool = True) -> WorldState:
        """The state as it is at a later stamp, s, with `process_noise` filled in; what has moved on is uncertain.

        carried : whether what rests may have been carried away, up to a metre.
        """
        least = self._default if carried else 0.0
        seconds = max(stamp - state.stamp, 0.0)
        objects = []
        for item in state.objects:
            track = self._tracks.get(item.id)
            unit = np.eye(len(item.covariance))
            rate = self._default if track is None else track.rate
            noise = max(rate, least) * unit
            away = max(least - rate, 0.0) * max(stamp - item.last_seen, 0.0)
            grown = item.covariance + (seconds * rate + min(away, ELSEWHERE**2)) * unit
            if MOVED_ON in item.predicates:
                grown = grown + ELSEWHERE**2 * unit
            objects.append(replace(item, covariance=grown, process_noise=noise))
        return replace(state, objects=tuple(objects), stamp=max(stamp, state.stamp))
