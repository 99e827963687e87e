"""What `whereabouts world` reads and writes besides evidence: moments in words, states, answers, events."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from estimation.errors import InputError
from whereabouts.system.atomic import write_csv
from world_model import WorldModel, WorldState
from world_model.queries import LAST_SEEN, QueryAnswer
from world_model.questions import moment as moment_of


def state_record(model: WorldModel, state: WorldState) -> dict[str, Any]:
    """One line of the states file."""
    return {
        "stamp": state.stamp,
        "epoch": state.epoch,
        "probability": state.probability,
        "expected_count": state.expected_count,
        "associations": list(state.associations),
        "objects": [
            {
                "id": item.id,
                "position": item.position.tolist(),
                "covariance": item.covariance.tolist(),
                "attributes": {name: dict(values) for name, values in item.attributes.items()},
                "quantities": {name: list(pair) for name, pair in item.quantities.items()},
                "existence": item.existence,
                "lost": item.lost,
                "last_seen": item.last_seen,
                "place": item.place,
                "place_probability": item.place_probability,
                "predicates": list(item.predicates),
            }
            for item in map(model.words.described, state.objects)
        ],
    }


def answer_record(answer: QueryAnswer) -> dict[str, Any]:
    """One answer of the figures file."""
    return {
        "id": answer.object.id,
        "probability": answer.probability,
        "position": answer.object.position.tolist(),
        "places": {name: p for name, p in answer.places.items() if p > 0.001},
        "description": answer.description,
        "stamp": answer.stamp,
    }


def moment(text: str, newest: float) -> float | str | None:
    """Seconds of a number or of a moment in words, as of questions, that ended with the newest stamp."""
    if not text:
        return None
    if text == LAST_SEEN:
        return text
    with suppress(ValueError):
        return float(text)
    try:
        return moment_of(text, newest).start
    except InputError as error:
        raise InputError(f'--at: seconds, "{LAST_SEEN}" or a time in words expected: {error}') from None


def write_events(model: WorldModel, path: Path | None) -> None:
    """All events of all runs as CSV: run, stamp, event, id."""
    if path is None or model.store is None:
        return
    rows = (
        (run, f"{stamp:.6f}", event, name)
        for run, *_ in model.store.epochs()
        for stamp, event, name in model.store.events(run)
    )
    write_csv(path, ("run", "stamp", "event", "id"), rows)


def write_looked_back(model: WorldModel, path: Path | None) -> None:
    """Object of each detection of a moving sensor, as all that was seen says, as CSV: stamp, index in its look, id."""
    if path is None:
        return
    rows = (
        (f"{stamp:.6f}", index, name or "")
        for stamp, names in model.look_back()
        for index, name in enumerate(names)
    )
    write_csv(path, ("stamp", "detection", "id"), rows)
