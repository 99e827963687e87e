"""`whereabouts world`: objects from recorded evidence, and questions to what was remembered; without ROS."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from whereabouts.cli.common import JsonFile, argument, file_to_write, option, require_places, write_figures
from whereabouts.system.counting import counted

if TYPE_CHECKING:
    from whereabouts.parameters.world_model import WorldModelParameters
    from whereabouts.recorded.world_log import LoggedLook
    from world_model import WorldEvidence, WorldModel, WorldState
    from world_model.memory.store import Store


Source = Annotated[
    Path,
    argument(
        "IN",
        "Bag with evidence, detections in space or targets, in the map's frame or with tf to it (or to odom), or "
        "with boxes, camera_info, depth and tf; or a store.",
    ),
]
Out = Annotated[Path | None, file_to_write("--out", "states.jsonl", "Write the world after every message.")]
Events = Annotated[
    Path | None, file_to_write("--events", "events.csv", "Write what happened to each object.")
]
StoreOption = Annotated[
    Path | None, option("--store", "Keep the world in this database file.", metavar="world.sqlite")
]
Params = Annotated[Path | None, option("--params", "ROS parameter file of the node world_model.")]
Places = Annotated[Path | None, option("--places", "Rooms and furniture.", metavar="home.yaml")]
LookBack = Annotated[
    Path | None,
    file_to_write(
        "--look-back",
        "corrected.csv",
        "For a moving sensor: at the end assign all detections to objects once more, and write them.",
    ),
]
LearnOption = Annotated[
    Path | None,
    file_to_write(
        "--learn",
        "learned.yaml",
        "Learn the detection probability, clutter and noise from the evidence. Write a parameter file.",
    ),
]
Predicate = Annotated[list[str] | None, option("--predicate", "Ask: objects with this symbol.")]
Region = Annotated[str, option("--region", "Ask: objects at this place, or near this object.")]
AtOption = Annotated[
    str, option("--at", 'Ask about this time: seconds, 2026-11-21T09:00, 09:00 (last day), or "last_seen".')
]
MinProbability = Annotated[
    float, option("--min-probability", "Leave out less probable answers.", min=0.0, max=1.0)
]


def world(
    source: Source,
    out: Out = None,
    events: Events = None,
    store: StoreOption = None,
    params: Params = None,
    places: Places = None,
    look_back: LookBack = None,
    learn: LearnOption = None,
    class_name: Annotated[str, option("--class", "Ask: objects of this class.")] = "",
    predicate: Predicate = None,
    region: Region = "",
    object_id: Annotated[str, option("--id", "Ask: this object.")] = "",
    at: AtOption = "",
    min_probability: MinProbability = 0.05,
    json_file: JsonFile = None,
) -> None:
    """Estimate which objects exist and where they are, from recorded evidence; or ask a store.

    It uses the evidence in the order of recording. At the end it prints the world, or the answer to the question: one
    line per object, the most probable first.
    """
    from estimation.errors import InputError
    from whereabouts.parameter_file import settings_for
    from whereabouts.recorded.world_output import moment, write_events, write_looked_back
    from world_model.memory.store import Store
    from world_model.memory.store_file import is_store

    require_places(places)
    named = {"places_file": places, "store_path": store}
    over = {name: str(path) for name, path in named.items() if path is not None}
    settings = settings_for(params, "world_model", **over)
    moment(at, 0.0)  # what cannot be understood is said before anything is read
    figures: dict[str, Any] = {"source": str(source)}
    question: dict[str, Any] = {
        "class_name": class_name,
        "predicate": predicate or (),
        "region": region or None,
    }
    question |= {"object_id": object_id, "min_probability": min_probability}
    if source.is_file() and is_store(source):
        if out or learn or store or look_back:
            raise InputError("--out, --learn, --look-back and --store need evidence; IN is a store")
        with Store(source, read_only=True) as kept:
            model = _with_words(settings, kept)
            _answer(model, question, at, figures)
            write_events(model, events)
    elif learn is not None:
        _learn(source, settings, learn, figures)
    else:
        with _model(settings, events is not None or bool(at)) as model:
            _take_in(source, settings, model, out, figures)
            write_looked_back(model, look_back)
            _answer(model, question, at, figures)
            write_events(model, events)
    write_figures(json_file, figures)


@contextmanager
def _model(settings: WorldModelParameters, remembering: bool) -> Iterator[WorldModel]:
    """A model with its store; a temporary one where the past is asked for and none is named."""
    import tempfile

    from world_model.memory.store import Store

    with tempfile.TemporaryDirectory() as folder:
        path = settings.store_path or (f"{folder}/world.sqlite" if remembering else "")
        store = Store(path) if path else None
        try:
            yield _with_words(settings, store)
        finally:
            if store is not None:
                store.close()


def _with_words(settings: WorldModelParameters, store: Store | None) -> WorldModel:
    from world_model import WorldModel
    from world_model.queries import Words

    model = WorldModel(settings.world, settings.places, store)
    model.words = Words(settings.places, settings.symbols)
    return model


def _looks(source: Path, settings: WorldModelParameters) -> Iterator[LoggedLook]:
    """Evidence with a progress bar; what was skipped is said at the end."""
    import numpy as np

    from whereabouts.recorded.camera_log import CameraSettings
    from whereabouts.recorded.evidence_messages import Reader
    from whereabouts.recorded.world_log import EvidenceLog
    from whereabouts.system.progress import share_bar

    config = settings.world
    known = {"class": config.classes, "color": config.colors}
    names = ("class", "color", *config.attributes)
    reader = Reader(known, names, config.measurement_sigma, settings.symbols, tuple(config.quantities))
    frame = settings.places.frame if settings.places_file else ""
    camera = CameraSettings(
        settings.map_frame,
        settings.base_frame,
        settings.camera_rectified,
        np.diag(np.square([settings.position_sigma, settings.position_sigma, settings.heading_sigma])),
    )
    with EvidenceLog(source, reader, frame, camera) as log, share_bar(f"reading {source.name}") as share:
        for count, look in enumerate(log.looks()):
            if count % 50 == 0:
                share(log.progress)
            yield look
        for line in log.summary.lines():
            typer.echo(line, err=True)
        for name, value in log.camera.rates.figures().items():
            typer.echo(f"{name}: {value}")


class _Taken:
    """Goes through looks with a model that takes them in: itself yields each that it takes, and where that leads.

    What it refuses is counted by reason, and said once it is through. seconds : spent in the model.
    """

    def __init__(self, model: WorldModel) -> None:
        self._model = model
        self.refused: Counter[str] = Counter()
        self.left_out: Counter[str] = Counter()
        self.count, self.seconds = 0, 0.0

    def of(self, looks: Iterable[LoggedLook]) -> Iterator[tuple[float, WorldEvidence, WorldState]]:
        """Stamp and evidence of what the model takes, and the world after it."""
        from estimation.errors import InputError

        for look in looks:
            begun = time.perf_counter()
            evidence, unknown = self._model.usable(look.evidence, wordless=look.evidence.view is not None)
            self.left_out.update(reason.partition(".")[2] for reason in unknown.values())
            try:
                state = self._model.update(evidence, look.stamp)
                for name in look.missing:
                    state = self._model.report(name, "not_found", look.stamp)
            except InputError as error:
                self.refused[str(error)] += 1
                continue
            self.seconds += time.perf_counter() - begun
            self.count += 1
            yield look.stamp, evidence, state
        for counts, what, done in (
            (self.refused, "message", "refused"),
            (self.left_out, "detection", "left out"),
        ):
            for reason, number in counts.items():
                typer.echo(f"{counted(number, what)} {done}: {reason}", err=True)


def _take_in(
    source: Path, settings: WorldModelParameters, model: WorldModel, out: Path | None, figures: dict[str, Any]
) -> None:
    import json
    from contextlib import ExitStack

    from whereabouts.recorded.world_output import state_record
    from whereabouts.system.atomic import atomic_path

    taken = _Taken(model)
    with ExitStack() as stack:
        file = None
        if out is not None:
            file = stack.enter_context(stack.enter_context(atomic_path(out)).open("w", encoding="utf-8"))
        for _, _, state in taken.of(_looks(source, settings)):
            if file is not None:
                file.write(json.dumps(state_record(model, state)) + "\n")
    figures |= {
        "messages": taken.count,
        "refused": taken.refused.total(),
        "left_out": taken.left_out.total(),
        "objects": int(model.health["objects"]),
        "runs": model.epoch + 1,
        "mean_update_ms": 1e3 * taken.seconds / max(taken.count, 1),
    }
    typer.echo(
        f"{counted(taken.count, 'message')}, {figures['mean_update_ms']:.2f} ms each: "
        f"{counted(figures['objects'], 'object')}"
        f"{f', written to {out}' if out else ''}{f', kept in {settings.store_path}' if settings.store_path else ''}"
    )


def _answer(model: WorldModel, question: dict[str, Any], at: str, figures: dict[str, Any]) -> None:
    """question : as `WorldModel.query` takes it; `at` : about which moment."""
    from whereabouts.recorded.world_output import answer_record, moment

    if model.store is not None and model.store.problem:
        typer.echo(model.store.problem, err=True)
    answers = model.query(**question, stamp=moment(at, model.stamp))
    figures["answers"] = [answer_record(answer) for answer in answers]
    for answer in answers:
        typer.echo(f"{answer.probability:.2f}  {answer.description}")
    if not answers:
        typer.echo("no object matches")


class _Watched(list[tuple[float, "WorldEvidence"]]):
    """Stamps and evidence; whoever goes through them shows how far it is."""

    def __iter__(self) -> Iterator[tuple[float, WorldEvidence]]:
        from whereabouts.system.progress import track

        return track(super().__iter__(), "learning", total=len(self))


def _learn(source: Path, settings: WorldModelParameters, out: Path, figures: dict[str, Any]) -> None:
    from whereabouts.parameters.yaml_text import given_section
    from whereabouts.system.atomic import write_text
    from world_model import WorldModel
    from world_model.learning import learn

    taken = _Taken(WorldModel(settings.world)).of(_looks(source, settings))
    looks = _Watched((stamp, evidence) for stamp, evidence, _ in taken)
    learned = learn(looks, settings.world)
    changed = {}
    for name in settings.model_dump():
        now, before = getattr(learned.config, name, None), getattr(settings.world, name, None)
        if isinstance(now, float) and now != before:
            changed[name] = now
    figures |= {
        "looks": len(looks),
        "learned": changed,
        "detection_probability_by_class": learned.by_class,
        "covariance_by_class": {name: P.tolist() for name, P in learned.covariances.items()},
        "objects": learned.objects,
    }
    given = {**settings.model_dump(), **changed}
    said = f"# Learned from {source.name}: {counted(len(looks), 'look')}, {counted(learned.objects, 'object')}.\n"
    write_text(out, said + given_section("/**", given))
    for name, value in changed.items():
        typer.echo(f"{name}: {getattr(settings.world, name):g} -> {value:g}")
    for name, share in sorted(learned.by_class.items()):
        typer.echo(f"{name}: detected in {100 * share:.0f} % of the observations")
    typer.echo(
        f"{counted(len(looks), 'observation')}, {counted(learned.objects, 'object')}, written to {out}"
    )
