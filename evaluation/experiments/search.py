"""Where to look for an object, over chains of intermediate ones (Figures 5.2 to 5.4, Table 5.1).

Rooms are made after a recipe and learned by looking around in thirty of them; the search is judged in rooms of another
design, entered from each corner, until the remote control is seen. A failed search ends in a sweep. Whole homes follow.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from estimation.geometry.grid_paths import GridPaths
from estimation.geometry.places import Places
from evaluation.drawing import saved
from evaluation.parallel import each
from evaluation.report import Part, Report, RunOptions
from evaluation.scenes.recipe_rooms import (
    RECIPE_SIZE,
    SMALLS,
    RecipeRoom,
    driven,
    learning_frames,
    recipe_room,
    swept,
)
from evaluation.scenes.search_homes import (
    CLEARANCE,
    FOUND,
    STRIDE,
    Home,
    driven_through,
    home,
    learned_homes,
)
from whereabouts.system.progress import track
from world_model.tasks.coverage import bounds_of
from world_model.tasks.relations import Relations
from world_model.tasks.search import Chain, ObjectSearch, SearchConfig

Array = np.ndarray
TARGET = "remote control"
ROOMS_SEEN = 30  # rooms that relations are learned from
NEIGHBOURS = ("coffee table", "side table", "two-seater", "tv")
STRATEGIES = ("belief", "belief, room unknown", "chain", "chain, p(o|T)", "direct", "sweep")
SIZES = (8.0, 10.0, 12.0, 15.0)  # m, of rooms beside those of RECIPE_SIZE
SCALES = (3.0, 4.0, 5.0, 5.5, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0, 15.0)  # of the view
QUICK_SCALES = (4.0, 5.0, 8.0, 12.0)
TABLE_5_1 = {"book": (0.20, 0.33, 0.11), "three-seater": (0.23, 0.11, 0.12), "keys": (0.21, 0.31, 0.09)}
Outcomes = dict[str, list[list[tuple[bool, float]]]]


def _relations(options: RunOptions, report: Report) -> None:
    """Table 5.1."""
    relations = _learned(options.seed, 4.0)
    theirs = {f"text: {name}": "Table 5.1" for name in NEIGHBOURS[:3]}
    columns = ["p(row | column)", *NEIGHBOURS[:3], *theirs]
    rows: list[list[object]] = [
        [name, *(relations.probability(name, given) for given in NEIGHBOURS[:3]), *printed]
        for name, printed in TABLE_5_1.items()
    ]
    note = "The text does not print its recipe: its rooms are others."
    title = "What is seen together, learned from simulation"
    report.add(title, columns, rows, note, "relations", theirs, "simulated", ROOMS_SEEN)


def _strategies(options: RunOptions, report: Report) -> None:
    """Figures 5.2 and 5.3, and one search with its reasons."""
    scales = QUICK_SCALES if options.quick else SCALES
    relations = _learned(options.seed, 4.0)
    outcomes = _all(options, relations, scales, options.share(60, 10))
    count = len(outcomes["sweep"][0])
    failures: list[list[object]] = []
    lengths: list[list[object]] = []
    shares: list[list[object]] = []
    for k, scale in enumerate(scales):
        path = {name: _length(outcomes[name][k]) for name in STRATEGIES}
        failures.append([f"{scale:g}", *(_failure(outcomes[name][k]) for name in STRATEGIES[:-1])])
        lengths.append([f"{scale:g}", *path.values()])
        of = [path[name] / path[other] for other in ("direct", "sweep") for name in STRATEGIES[:3]]
        shares.append([f"{scale:g}", *of])
    note = f"A room of {RECIPE_SIZE:g} m, entered from each corner. In the text's rooms its rule, chain, hardly fails."
    for name, title, columns, rows, said in (
        ("failures", "Searches that fail", [f"{s}, % ↓" for s in STRATEGIES[:-1]], failures, note),
        (
            "paths", "Path until the target is seen", [f"{s}, m ↓" for s in STRATEGIES], lengths,
            "After a failed search the robot sweeps the whole room.",
        ),
        (
            "shares", "Path beside that of the direct neighbours and of the sweep",
            [f"{s}, of {other}, × ↓" for other in ("direct", "sweep") for s in STRATEGIES[:3]], shares,
            "Asked for: 0.6 of direct at view scales 4 and 5, 1.05 above 5, 0.5 of the sweep from 4 to 7. Belief, "
            "direct and the sweep know where the room's middle is.",
        ),
    ):  # fmt: skip
        report.add(title, ["view scale", *columns], rows, said, name, data="simulated", samples=count)
    _draw(options.out, outcomes, scales, report)
    report.pictures.append(_draw_room(options.out, relations, options.seed))


def _learned(seed: int, view_scale: float, width: float = RECIPE_SIZE) -> Relations:
    return Relations.from_frames(
        learning_frames(np.random.default_rng([seed, 4]), view_scale, ROOMS_SEEN, width)
    )


def _known_room(width: float = RECIPE_SIZE) -> Places:
    square = [[0.0, 0.0], [width, 0.0], [width, width], [0.0, width]]
    return Places.from_mapping({"places": {"living room": {"polygon": square, "type": "living room"}}})


class _Ours:
    """`ObjectSearch` as the simulated robot asks it: None where only a random search is left."""

    def __init__(
        self, search: ObjectSearch, target: str = TARGET, over: Sequence[str] = ("random", "none")
    ) -> None:
        self._search, self._target, self._over = search, target, over

    def next_goal(self, known: Mapping[str, Array], place: Array) -> Array | None:
        step = self._search.next_goal(known, self._target, [*place, 0.0])
        return None if step.kind in self._over else step.goal

    def reached(self, goal: Array) -> None:
        self._search.reached(goal)


class _UninvertedChain(Chain):
    """The chain with the relation p(o | T) as it was counted, without the text's inversion (5.2)."""

    def _given(self, goal: str, observed: Iterable[str]) -> dict[str, float]:
        return {name: self._relations.probability(name, goal) for name in observed}


class _Uninverted(ObjectSearch):
    """A search that follows it."""

    chain_type = _UninvertedChain


class _Direct:
    """The text's benchmark (section 5.4.2): only the target's own neighbours, from the middle of the room."""

    def __init__(self, relations: Relations, middle: Array) -> None:
        self._chance = {name: relations.probability(TARGET, name) for name in NEIGHBOURS}
        self._middle, self._was_there = middle, False
        self._tried: set[str] = set()
        self._current = ""

    def next_goal(self, known: Mapping[str, Array], place: Array) -> Array | None:
        left = [name for name in known if name in self._chance and name not in self._tried]
        if left:
            self._current = max(left, key=lambda name: self._chance[name])
            return known[self._current]
        self._current = ""
        return None if self._was_there else self._middle

    def reached(self, goal: Array) -> None:
        if self._current:
            self._tried.add(self._current)
        else:
            self._was_there = True


def _one(
    room: RecipeRoom, corner: Array, strategy: str, relations: Relations, scale: float
) -> tuple[bool, float]:
    if strategy == "sweep":
        return False, swept(room, corner, TARGET, scale)
    if strategy == "direct":
        chooser: _Direct | _Ours = _Direct(relations, np.full(2, 0.5 * room.width))
    elif strategy == "chain, p(o|T)":
        chooser = _Ours(_Uninverted(relations, SearchConfig(method="chain")))
    elif strategy == "chain":
        chooser = _Ours(ObjectSearch(relations, SearchConfig(method="chain")))
    else:
        # From how far it recognises the target a robot knows.
        config = SearchConfig(view=scale * SMALLS[TARGET][0])
        places = _known_room(room.width) if strategy == "belief" else None
        chooser = _Ours(ObjectSearch(relations, config, places))
    outcome = driven(room, corner, TARGET, scale, chooser.next_goal, chooser.reached)
    return outcome.failed, outcome.length


def _room_outcomes(
    seed: int, relations: Relations, scale: float, strategies: tuple[str, ...], width: float = RECIPE_SIZE
) -> list[list[tuple[bool, float]]]:
    room = recipe_room(np.random.default_rng(seed), redesigned=True, width=width)
    return [[_one(room, corner, name, relations, scale) for name in strategies] for corner in room.corners()]


def _all(
    options: RunOptions, relations: Relations, scales: tuple[float, ...], rooms: int,
    strategies: tuple[str, ...] = STRATEGIES, label: str = "view scales", width: float = RECIPE_SIZE,
) -> Outcomes:  # fmt: skip
    """Per strategy and view scale, (failed, length) of every room and corner."""
    results: Outcomes = {name: [] for name in strategies}
    seeds = options.draws(5, rooms)
    for scale in track(list(scales), label):
        calls = [(seed, relations, scale, strategies, width) for seed in seeds]
        runs = each(_room_outcomes, calls, options.jobs)
        flat = [corner for room in runs for corner in room]
        for index, name in enumerate(strategies):
            results[name].append([corner[index] for corner in flat])
    return results


def _failure(outcomes: list[tuple[bool, float]]) -> float:
    return 100.0 * float(np.mean([failed for failed, _ in outcomes]))


def _length(outcomes: list[tuple[bool, float]]) -> float:
    return float(np.mean([length for _, length in outcomes]))


def _sizes(options: RunOptions, report: Report) -> None:
    """In how large a room the text's plain rule still finds its way: its own room's size is not printed."""
    strategies, scales = ("belief", "belief, room unknown", "chain", "direct"), (4.0, 5.0)
    sizes = SIZES[1::2] if options.quick else SIZES
    rooms = options.share(40, 10)
    rows: list[list[object]] = []
    for width in sizes:
        relations = _learned(options.seed, 4.0, width)
        found = _all(options, relations, scales, rooms, strategies, f"rooms of {width:g} m", width)
        for k, scale in enumerate(scales):
            rows.append(
                [f"{width:g} m", f"view scale {scale:g}", *(_failure(found[name][k]) for name in strategies)]
            )
    note = "In small rooms some neighbour of the target is in view from the middle."
    columns = ["side", "", *(f"{name}, % ↓" for name in strategies)]
    report.add(
        "Searches that fail, by the size of the room", columns, rows, note, "sizes",
        data="simulated", samples=4 * rooms,
    )  # fmt: skip


class _GreedyFloor:
    """A plain planner: the place from which most unseen floor comes into view per metre of the way there, floor
    counting by the share of its type of room among where the target was seen; by nothing where `shares` is empty."""

    def __init__(self, made: Home, shares: Mapping[str, float]) -> None:
        self._grid = made.grid
        low, high = bounds_of(made.grid)
        x, y = (np.arange(low[a], high[a], 2.0 * STRIDE) for a in range(2))
        cells = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        self._cells = cells[made.grid.lookup(cells) < 0.0]
        self._weights = np.ones(len(self._cells))
        for room in made.places.rooms if shares else ():
            inside = room.contains(self._cells)
            self._weights[inside] = (shares.get(room.type, 0.0) + 1e-3) / max(
                int(np.count_nonzero(inside)), 1
            )
        self._left = np.ones(len(self._cells), dtype=bool)
        self._going = -1

    def next_goal(self, known: Mapping[str, Array], place: Array) -> Array | None:
        offsets = self._cells - place
        away = np.hypot(*offsets.T)
        near = np.flatnonzero(self._left & (away <= FOUND))
        seen = self._grid.ray_cast(place, np.arctan2(*offsets[near].T[::-1]), FOUND) >= away[near]
        self._left[near[seen]] = False
        if self._going < 0 or not self._left[self._going]:
            left = np.flatnonzero(self._left)
            lengths = GridPaths(self._grid, place, CLEARANCE).lengths(self._cells[left])
            able = np.isfinite(lengths)
            if not able.any():
                return None
            goals = left[able]
            close = (
                np.hypot(*(self._cells[goals, None] - self._cells[None, left]).transpose(2, 0, 1)) <= FOUND
            )
            self._going = goals[np.argmax(close @ self._weights[left] / (lengths[able] + 1.0))]
        return np.asarray(self._cells[self._going])

    def reached(self, goal: Array) -> None:
        self._left[self._going] = False


def _home_outcomes(seed: int, relations: Relations) -> list[float]:
    """Metres of the search and of both plain planners in one home."""
    made = home(seed)
    shares = relations.rooms(made.target, sorted({room.type for room in made.places.rooms}))
    search = ObjectSearch(relations, SearchConfig(view=FOUND), made.places, made.grid)
    choosers = (_Ours(search, made.target, ("none",)), _GreedyFloor(made, shares), _GreedyFloor(made, {}))
    return [driven_through(made, chooser) for chooser in choosers]


def _homes(options: RunOptions, report: Report) -> None:
    """Homes of several rooms."""
    count = options.share(500, 100)
    relations = learned_homes(options.seed, 60)
    seeds = options.draws(6, count)
    lengths = np.array(each(_home_outcomes, [(seed, relations) for seed in seeds], options.jobs, "homes"))
    names = ("search", "most floor per metre, by rooms", "most floor per metre")
    rows: list[list[object]] = [
        [name, float(path.mean()), float(np.median(path)), float(np.quantile(path, 0.9))]
        for name, path in zip(names, lengths.T, strict=True)
    ]
    note = "From four to eight rooms, most with doors to their neighbours; one thing in four lies anywhere."
    columns = ["", "path, mean, m ↓", "median, m ↓", "90 % are shorter than, m ↓"]
    report.add("Search through homes", columns, rows, note, "homes", data="simulated", samples=count)


def _teachers(options: RunOptions, report: Report) -> None:
    """Figure 5.4: relations learned with another view scale."""
    teachers = (4.0, 15.0) if options.quick else (4.0, 5.0, 10.0, 15.0)
    scales = (4.0, 8.0) if options.quick else (4.0, 5.0, 7.0, 10.0, 13.0)
    rooms = options.share(40, 10)
    rows: list[list[object]] = [[f"{scale:g}"] for scale in scales]
    for teacher in teachers:
        relations = _learned(options.seed, teacher)
        found = _all(options, relations, scales, rooms, ("belief",), f"learned at {teacher:g}")
        for row, outcome in zip(rows, found["belief"], strict=True):
            row.append(_length(outcome))
    columns = ["view scale", *(f"learned at {teacher:g}, m ↓" for teacher in teachers)]
    title, note = "Path by the view scale while learning", "The text sees no effect (Figure 5.4)."
    report.add(title, columns, rows, note, "teachers", data="simulated", samples=4 * rooms)


def _draw(out: Path, outcomes: Outcomes, scales: tuple[float, ...], report: Report) -> None:
    figure = Figure(figsize=(10, 3.6))
    panels = figure.subplots(1, 2)
    for name, found in outcomes.items():
        if name != "sweep":
            panels[0].plot(scales, [_failure(one) for one in found], marker=".", label=name)
        panels[1].plot(scales, [_length(one) for one in found], marker=".", label=name)
    panels[0].set(xlabel="view scale", ylabel="failures, %")
    panels[1].set(xlabel="view scale", ylabel="path, m", ylim=(0.0, None))
    panels[1].legend(fontsize=8)
    for axes in panels:
        axes.grid(alpha=0.3)
    report.pictures.append(saved(figure, out / "figures-5-2-and-5-3.png", 130))


def _draw_room(out: Path, relations: Relations, seed: int) -> Path:
    """One search, with its reasons."""
    from matplotlib.patches import Circle

    room = recipe_room(np.random.default_rng([seed, 6]), redesigned=True)
    search = ObjectSearch(relations, places=_known_room())
    trail: list[Array] = []
    reasons: list[str] = []

    def next_goal(known: Mapping[str, Array], place: Array) -> Array | None:
        step = search.next_goal(known, TARGET, [*place, 0.0])
        if not reasons or reasons[-1] != step.reason:
            reasons.append(step.reason)
        trail.append(place.copy())
        return step.goal

    driven(room, room.corners()[0], TARGET, 4.0, next_goal, search.reached)
    figure = Figure(figsize=(7.5, 6))
    axes = figure.subplots()
    for name, spot in room.positions.items():
        size = room.sizes[name]
        x, y = float(spot[0]), float(spot[1])
        axes.add_patch(Circle((x, y), 0.35 * size, color="C3" if name == TARGET else "0.75"))
        if size > 0.65:
            axes.annotate(name, (x, y), fontsize=7, ha="center")
        elif name == TARGET:
            arrow = {"arrowstyle": "-", "color": "C3"}
            axes.annotate(
                name, (x, y), (28, 30), textcoords="offset points", fontsize=8, color="C3", arrowprops=arrow
            )
    axes.plot(*np.array(trail).T, "C0.-", lw=1)
    title = "\n".join(f"{k}. {reason}" for k, reason in enumerate(reasons[:6], start=1))
    axes.set_title(title, fontsize=7, loc="left")
    side = math.ceil(room.width)
    axes.set(xlim=(0, side), ylim=(0, side), aspect="equal", xlabel="x, m", ylabel="y, m")
    return saved(figure, out / "a-search.png", 130)


PARTS = {
    "relations": Part(_relations),
    "strategies": Part(_strategies),
    "sizes": Part(_sizes),
    "teachers": Part(_teachers),
    "homes": Part(_homes),
}
