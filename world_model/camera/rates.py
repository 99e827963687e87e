"""What a detector does on this robot: how often it finds what is in view, and names it right.

Learned from ordinary driving. An object that was in view and not found counts as missed once it has been found again at
its place: otherwise it may have been gone. Detection goes by apparent size, in octaves, since distance and size decide.
What a camera has never found, and others find where it looks, is of a class that its detector does not know.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from estimation.checks import FloatArray
from estimation.errors import InputError
from world_model.kept_file import read_kept, write_kept
from world_model.state import WorldObject

PIXELS = 16.0  # Apparent size at which half of the things are recognised, until it has been learned
STEEPNESS = 4.0
FIRST, OCTAVES = 2, 8  # The smallest octave is up to 2 ** (FIRST + 1) pixels
PRIOR = 4.0  # Looks that the assumed rate counts for, an octave
FEWEST = 10  # Looks of which a rate is told
SURELY = 0.95
COUNTED = ("named", "finds", "unknown")
FORMAT, VERSION = "whereabouts camera rates", 1
SUFFIX = ".camera"  # Of the file beside the store


class SightRates:
    """pixels : apparent size at which half of the things are recognised, before anything is learned."""

    def __init__(self, pixels: float = PIXELS) -> None:
        self.pixels = pixels
        self.found = np.zeros(OCTAVES)
        self.missed = np.zeros(OCTAVES)
        self.named: Counter[tuple[str, str]] = Counter()
        self.looks = self.unexplained = 0
        self.finds: Counter[tuple[str, str]] = Counter()
        self.unknown: Counter[tuple[str, str]] = Counter()
        """Looks of a camera at things of a class, by both: in which it found them, and not, though others did."""
        self._open: dict[tuple[str, str], tuple[float, FloatArray]] = {}

    def recognisable(self, apparent: FloatArray) -> FloatArray:
        """Probability (N,) that something of an apparent size (N,), pixels, is reported."""
        assumed = 1.0 / (1.0 + (self.pixels / np.maximum(apparent, 1e-6)) ** STEEPNESS)
        octave = _octave(apparent)
        total = self.found + self.missed
        return (self.found[octave] + PRIOR * assumed) / (total[octave] + PRIOR)

    def reported(self, camera: str, kinds: Sequence[str]) -> FloatArray:
        """Probability (N,) that the detector of a camera knows classes."""
        finds = PRIOR + np.array([self.finds[camera, kind] for kind in kinds])
        return np.asarray(finds / (finds + [self.unknown[camera, kind] for kind in kinds]))

    def look(
        self,
        objects: Sequence[WorldObject],
        apparent: FloatArray,
        found: Iterable[str | None],
        camera: str = "",
    ) -> None:
        """One look of a camera: objects that were surely in view, their apparent sizes (N,), and whose each detection
        was."""
        told = list(found)
        here = set(told)
        self.looks += 1
        self.unexplained += sum(name is None for name in told)
        for item, octave in zip(objects, _octave(apparent).tolist(), strict=True):
            key, kind = (camera, item.id), (camera, item.most_probable("class"))
            since, missed = self._open.pop(key, (item.last_seen, np.zeros(OCTAVES)))
            if item.id in here:
                self.finds[kind] += 1
                self.found[octave] += 1.0
                self.missed += missed
                continue
            if item.last_seen > since:  # others have found it meanwhile
                if self.finds[kind] > self.unknown[kind]:
                    self.missed += missed
                else:
                    self.unknown[kind] += int(missed.sum())
                since, missed = item.last_seen, np.zeros(OCTAVES)
            missed[octave] += 1.0
            self._open[key] = since, missed

    def name(self, objects: Sequence[WorldObject], said: Mapping[str, Mapping[str, float]]) -> None:
        """Which class each object was given, {id: distribution}, against what is surely known of it."""
        for item in objects:
            known = item.attributes.get("class", {})
            given = said.get(item.id)
            if given and known and max(known.values()) > SURELY:
                self.named[(item.most_probable("class"), max(given, key=given.__getitem__))] += 1

    def forget(self, gone: Iterable[str]) -> None:
        """Objects that are not where they were: they were not missed."""
        names = set(gone)
        self._open = (
            {key: value for key, value in self._open.items() if key[1] not in names} if names else self._open
        )

    def write(self, path: Path) -> None:
        """Write what was learned to a file. Raises OSError."""
        data: dict[str, object] = {"format": FORMAT, "version": VERSION}
        for name in COUNTED:
            data[name] = [[*key, count] for key, count in getattr(self, name).items()]
        data |= {"found": self.found.tolist(), "missed": self.missed.tolist()}
        write_kept(path, data | {"looks": self.looks, "unexplained": self.unexplained})

    def read(self, path: Path) -> None:
        """Go on from what `write` wrote. Raises OSError, and InputError where the file is no such one; nothing is
        changed then."""
        data = read_kept(path, FORMAT, VERSION)
        try:
            found, missed = (np.array(data[name], dtype=np.float64) for name in ("found", "missed"))
            counted = {
                name: Counter({(str(a), str(b)): int(n) for a, b, n in data.get(name, [])})
                for name in COUNTED
            }
            looks, unexplained = int(data["looks"]), int(data["unexplained"])
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"damaged: {error}") from error
        counts = np.concatenate([found.ravel(), missed.ravel(), [looks, unexplained]])
        if found.shape != (OCTAVES,) or missed.shape != (OCTAVES,) or not (counts >= 0.0).all():
            raise InputError(f"damaged: {OCTAVES} counts of at least 0 expected of each kind")
        self.found, self.missed = found, missed
        for name, counter in counted.items():
            setattr(self, name, counter)
        self.looks, self.unexplained = looks, unexplained

    def figures(self) -> dict[str, str]:
        """What has been learned, in words, of what was seen often enough."""
        told = {}
        for octave in np.flatnonzero(self.found + self.missed >= FEWEST).tolist():
            low, high = 2 ** (octave + FIRST), 2 ** (octave + FIRST + 1)
            total = self.found[octave] + self.missed[octave]
            told[f"found at {low} to {high} px"] = f"{self.found[octave] / total:.2f} of {total:.0f}"
        total = self.named.total()
        if total >= FEWEST:
            right = sum(count for (known, said), count in self.named.items() if known == said)
            told["named right"] = f"{right / total:.2f} of {total}"
            wrong = Counter({pair: count for pair, count in self.named.items() if pair[0] != pair[1]})
            for (known, said), count in wrong.most_common(1):
                told["most often confused"] = f"{known} called {said}: {count}"
        for camera in sorted({camera for camera, _ in self.unknown}):
            kinds = sorted(kind for _, kind in self.unknown if self.reported(camera, [kind])[0] < 0.5)
            if kinds:
                told[f"classes that {camera or 'the camera'} does not know"] = ", ".join(kinds)
        if self.looks >= FEWEST:
            told["detections nobody believes"] = f"{self.unexplained / self.looks:.3f} a look"
        return told


def _octave(apparent: FloatArray) -> np.ndarray:
    octave = np.floor(np.log2(np.maximum(apparent, 1.0))).astype(np.int64) - FIRST
    return np.clip(octave, 0, OCTAVES - 1)
