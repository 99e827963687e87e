"""What is usually found with what: object-object and object-room probabilities from counted frames (section 5.2).

A frame is the set of object names seen at once. (5.1): p(o_i | o_j) = (N(o_i, o_j) + λ) / (N(o_j) + λ n_obj), and
likewise for rooms.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_number, require_word
from estimation.errors import InputError

IntArray = npt.NDArray[np.int64]


class Relations:
    """Counts of names, pairs and rooms; probabilities by Lidstone's law.

    smoothing : λ, 0.5 by Jeffreys and Perks. fading : factor on all counts at each frame, 1 to never forget.
    minimum : pairs seen less often than this count as never seen. synonyms : {name: name to use instead}.

    Raises InputError: a negative λ, a fading outside (0, 1], synonyms that are no words or lead back to themselves.
    """

    def __init__(
        self,
        smoothing: float = 0.5,
        fading: float = 1.0,
        minimum: float = 0.0,
        synonyms: Mapping[str, str] | None = None,
    ) -> None:
        if as_number("smoothing", smoothing) < 0.0:
            raise InputError(f"smoothing: a number of at least 0 expected, got {smoothing!r}")
        if not 0.0 < as_number("fading", fading) <= 1.0:
            raise InputError(f"fading: above 0 up to 1 expected, got {fading!r}")
        self.smoothing, self.fading = float(smoothing), float(fading)
        self.minimum = as_number("minimum", minimum)
        self.synonyms = _resolved(synonyms or {})
        self._index: dict[str, int] = {}
        # By type of room, None for all of them: frames, and pairs (n, n) with single names on the diagonal.
        self._frames: dict[str | None, float] = {None: 0.0}
        self._pairs: dict[str | None, FloatArray] = {None: np.zeros((0, 0))}
        self._scale = 1.0  # what one new frame counts: fading old counts by growing new ones

    @classmethod
    def from_frames(
        cls, frames: Iterable[Sequence[str]], smoothing: float = 0.5, minimum: float = 0.0
    ) -> Relations:
        """Relations counted over frames, each a list of names seen at once."""
        relations = cls(smoothing, minimum=minimum)
        for names in frames:
            relations.observe(names)
        return relations

    @classmethod
    def load(cls, path: Path | str) -> Relations:
        """Relations from YAML: `frames` (lists of names, or {names, room, count}), `smoothing`, `minimum`, `synonyms`.

        Raises InputError: the file is missing or malformed; names where.
        """
        import yaml

        try:
            content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise InputError(f"{path}: cannot be read: {error}") from error
        if not isinstance(content, dict) or not isinstance(content.get("frames"), list):
            raise InputError(f"{path}: a mapping with a list `frames` expected")
        relations = cls(
            float(content.get("smoothing", 0.5)),
            minimum=float(content.get("minimum", 0.0)),
            synonyms=content.get("synonyms"),
        )
        for number, frame in enumerate(content["frames"], start=1):
            entry = frame if isinstance(frame, dict) else {"names": frame}
            names: list[str] = entry.get("names", [])
            count = entry.get("count", 1)
            good = isinstance(names, list) and len(names) > 0 and all(isinstance(name, str) for name in names)
            if not good or not isinstance(count, (int, float)) or not (math.isfinite(count) and count >= 0):
                raise InputError(
                    f"{path}: frame {number}: names (list of words) and a count of at least 0 expected"
                )
            relations.observe(names, entry.get("room"), float(count))
        return relations

    @classmethod
    def from_labelme(
        cls, paths: Iterable[Path | str], minimum: float = 5.0, synonyms: Mapping[str, str] | None = None
    ) -> Relations:
        """Relations from annotated images in the LabelMe format (XML or JSON), one image a frame.

        paths : files, or folders that are searched for them. minimum : pairs seen less often are dropped, as in the
        text. Annotations that were deleted do not count.

        Raises InputError: no file at all, or one that is no annotation; names it.
        """
        relations = cls(minimum=minimum, synonyms=synonyms)
        files: list[Path] = []
        for path in map(Path, paths):
            found = (*path.rglob("*.xml"), *path.rglob("*.json")) if path.is_dir() else (path,)
            files += sorted(found)
        if not files:
            raise InputError("paths: no LabelMe annotation (.xml or .json) was found")
        for file in files:
            relations.observe(_labelme_names(file))
        return relations

    @classmethod
    def common_sense(cls) -> Relations:
        """What ships: household rooms and objects, made by hand (`world_model/defaults/relations.yaml`)."""
        from importlib.resources import as_file, files

        with as_file(files("world_model") / "defaults" / "relations.yaml") as path:
            return cls.load(path)

    @property
    def names(self) -> list[str]:
        """Known names, in the order they were first seen."""
        return list(self._index)

    def __contains__(self, name: str) -> bool:
        return self.unified(name) in self._index

    def unified(self, name: str) -> str:
        """The name to use for a name: its synonym, in lower case."""
        plain = require_word("name", name).strip().lower()
        return self.synonyms.get(plain, plain)

    def observe(self, names: Iterable[str], room: str | None = None, count: float = 1.0) -> None:
        """Count a frame: every name once, every pair of names once.

        Raises InputError: names that are none, such as one text, and a count that is negative or not finite.
        """
        if as_number("count", count) < 0.0:
            raise InputError(f"count: a number of at least 0 expected, got {count!r}")
        if isinstance(names, str) or not isinstance(names, Iterable):
            raise InputError(f"names must be several names, not {names!r}")
        if room is not None:
            require_word("room", room)
        seen = sorted({self.unified(name) for name in names} - {""})
        self._scale /= self.fading
        if self._scale > 1e12:
            self._settle()
        rows = np.array([self._index.setdefault(name, len(self._index)) for name in seen], dtype=np.int64)
        weight = count * self._scale
        # Where nothing is seen there is no telling the room.
        for kind in dict.fromkeys((None, room)) if seen else (None,):
            self._frames[kind] = self._frames.get(kind, 0.0) + weight
            self._pairs[kind] = self._pairs_in(kind)
            self._pairs[kind][np.ix_(rows, rows)] += weight

    def count(self, name: str, other: str | None = None) -> float:
        """How often a name, or a pair of names, was seen; faded."""
        i, j = (self._index.get(self.unified(word)) for word in (name, name if other is None else other))
        return 0.0 if i is None or j is None else float(self._pairs[None][i, j] / self._scale)

    def probability(self, name: str, given: str) -> float:
        """(5.1): p(name | given) of seeing the one in a frame that has the other; for unknown names by λ alone."""
        number = max(len(self._index), 1)
        together = self.count(name, given)
        together = together if together >= self.minimum else 0.0
        base = self.count(given) + self.smoothing * number
        return (together + self.smoothing) / base if base > 0.0 else 1.0 / number

    def matrix(self) -> FloatArray:
        """(n, n) of p(row | column) over `names`, (5.1)."""
        every = np.arange(len(self._index))
        return self.block(every, every)

    def _pairs_in(self, room: str | None) -> FloatArray:
        """Counts of pairs (n, n) in rooms of a type; of single names on the diagonal."""
        known = self._pairs.get(room, np.zeros((0, 0)))
        more = len(self._index) - len(known)
        return np.pad(known, (0, more)) if more else known

    def block(self, rows: IntArray, columns: IntArray, room: str = "") -> FloatArray:
        """(R, C) of p(row | column) for indices into `names`, (5.1): of many names few pairs are ever asked for.

        room : type of room; what was seen in others counts as the prior there, with the weight that (5.1) gives it.
        """
        # Pairs are symmetric: of the two ways to cut them out, the one along rows is read in one go.
        few, known = len(rows) < len(columns), self._pairs[None]
        prior = known[rows][:, columns] if few else known[columns][:, rows].T
        prior = prior / self._scale
        if self.minimum > 0.0:
            prior[prior < self.minimum] = 0.0
        base = known.diagonal()[columns] / self._scale + self.smoothing * max(len(self._index), 1)
        prior += self.smoothing
        prior /= np.maximum(base, 1e-300)[None, :]
        if room not in self._pairs:
            return prior
        pairs = self._pairs_in(room)[np.ix_([*rows, *columns], columns)] / self._scale
        weight = self.smoothing * len(self._index)
        base = pairs[len(rows) :].diagonal() + weight
        joint = pairs[: len(rows)] + weight * prior
        return np.where(base > 0.0, joint / np.maximum(base, 1e-300), prior)

    def ubiquity(self, room: str = "") -> FloatArray:
        """(n,) share of all frames that show each of `names`; what is in view everywhere says nothing about where.

        room : type of room, as for `block`.
        """
        share: FloatArray = self._pairs[None].diagonal() / max(self._frames[None], 1e-300)
        if room not in self._pairs:
            return share
        weight = self.smoothing * len(self._index) * self._scale
        base = max(self._frames[room] + weight, 1e-300)
        return np.asarray((self._pairs_in(room).diagonal() + weight * share) / base)

    def posterior(self, target: str, observed: Sequence[str]) -> dict[str, float]:
        """(5.2): p(o_j | o_T) over the observed names; sums to one."""
        total = sum(self.count(name) for name in observed) or 1.0
        prior = {name: max(self.count(name), 1e-9 * total) / total for name in observed}
        joint = {name: self.probability(target, name) * prior[name] for name in observed}
        norm = sum(joint.values())
        return {name: value / norm for name, value in joint.items()} if norm > 0.0 else {}

    def _in_room(self, name: str, room: str) -> float:
        """p(name | room): the share of the room's frames that show it, smoothed as (5.1)."""
        number = max(len(self._index), 1)
        at = self._index.get(self.unified(name))
        here = 0.0 if at is None else self._pairs_in(room)[at, at]
        base = self._frames.get(room, 0.0) / self._scale + self.smoothing * number
        return (here / self._scale + self.smoothing) / base if base > 0.0 else 1.0 / number

    def rooms(self, target: str, among: Sequence[str]) -> dict[str, float]:
        """p(room | target) over room types, by Bayes' law with equal priors; sums to one."""
        likelihood = {room: self._in_room(target, room) for room in among}
        norm = sum(likelihood.values())
        return {room: value / norm for room, value in likelihood.items()} if norm > 0.0 else {}

    def _settle(self) -> None:
        """Carry out the fading, before numbers grow too large."""
        self._frames = {room: frames / self._scale for room, frames in self._frames.items()}
        self._pairs = {room: pairs / self._scale for room, pairs in self._pairs.items()}
        self._scale = 1.0


def _resolved(synonyms: Mapping[str, str]) -> dict[str, str]:
    """Synonyms in lower case, chains of them followed to their ends."""
    words = isinstance(synonyms, Mapping) and all(
        isinstance(word, str) for pair in synonyms.items() for word in pair
    )
    if not words:
        raise InputError(f"synonyms: words by word expected, got {synonyms!r}")
    plain = {name.strip().lower(): other.strip().lower() for name, other in synonyms.items()}
    ends = {}
    for name in plain:
        end, passed = name, set()
        while end in plain and plain[end] != end:
            if end in passed:
                raise InputError(f"synonyms: {name!r} leads back to itself")
            passed.add(end)
            end = plain[end]
        ends[name] = end
    return ends


def _labelme_names(path: Path) -> list[str]:
    """Names in one annotation: LabelMe's XML, or the JSON of the tool of the same name."""
    import json
    from xml.etree import ElementTree

    try:
        if path.suffix == ".json":
            shapes = json.loads(path.read_text(encoding="utf-8"))["shapes"]
            return [str(shape["label"]) for shape in shapes]
        items = ElementTree.parse(path).getroot().iter("object")
        return [
            (item.findtext("name") or "")
            for item in items
            if (item.findtext("deleted") or "0").strip() != "1"
        ]
    except (OSError, ValueError, KeyError, TypeError, ElementTree.ParseError) as error:
        raise InputError(f"{path}: no LabelMe annotation: {error!r}") from error
