"""A server of the Model Context Protocol: tools and resources over what the suite knows."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Callable
from functools import wraps
from importlib.metadata import PackageNotFoundError, version
from inspect import signature
from io import BytesIO
from typing import Annotated, Any

from mcp.server.mcpserver import Context, MCPServer
from mcp.server.mcpserver.exceptions import ResourceError, ToolError
from mcp_types import ToolAnnotations
from pydantic import BaseModel, Field, ValidationError

from estimation.errors import WhereaboutsError
from whereabouts.agents.knowledge import Knowledge
from world_model import questions
from world_model.questions import Answer, Recall, answered
from world_model.questions.answers import clean, clock, iso, listed
from world_model.questions.naming import name_of, one_present

INSTRUCTIONS = (
    "What a robot remembers of its home: where objects are and were, what changed, what is missing, who was where. "
    "Names are ids (cup-3), classes (cup) or colours with classes (red cup); times are ISO 8601 or plain words "
    '("yesterday morning", "at nine", "since breakfast"). Every result has a probability; below 0.9 say "probably".'
)
Name = Annotated[
    str, Field(description='Object: an id ("cup-3"), a class ("cup") or a colour with a class ("red cup").')
]
Since = Annotated[
    str,
    Field(
        description='Moment: ISO 8601 (2026-11-21T09:00) or plain words ("yesterday morning", "two hours ago").'
    ),
]
PlaceName = Annotated[
    str, Field(description='Room or furniture ("kitchen", "kitchen table"); "" for anywhere.')
]


class ToldAnswer(BaseModel):
    """One sentence and the record behind it."""

    sentence: str = Field(description="The answer for people.")
    ok: bool = Field(description="Whether the question was answered, or what was asked for was done.")
    probability: float = Field(ge=0.0, le=1.0, description="That the answer is right, from 0 to 1.")
    stamp: str = Field(
        description='Moment that the answer is about, ISO 8601 with offset; "" where there is none.'
    )
    value: Any = Field(
        default=None,
        description="For programs: a place, ids, a number (durations in s), an ISO 8601 moment; null: unknown.",
    )
    evidence: list[dict[str, Any]] = Field(
        default=[], description="What was seen: object, event, place, stamp (ISO 8601)."
    )
    alternatives: list[dict[str, Any]] = Field(
        default=[], description="Other answers, each with a probability."
    )
    choices: list[str] = Field(
        default=[], description="What an ambiguous name may mean: ask with one of them."
    )


def told(answer: Answer) -> ToldAnswer:
    """The answer to a question as a result."""
    ok = answer.kind not in ("not_understood", "unknown", "choices")
    share = min(max(answer.probability, 0.0), 1.0)
    return ToldAnswer.model_validate({**answer.to_dict(), "ok": ok, "probability": share})


def refused(sentence: str) -> ToldAnswer:
    """A result that says why there is none."""
    return ToldAnswer(sentence=sentence, ok=False, probability=0.0, stamp="")


class Server(MCPServer[Any]):
    """Says in a sentence what is wrong with a call."""

    async def call_tool(
        self, name: str, arguments: dict[str, Any], context: Context[Any, Any] | None = None
    ) -> Any:
        try:
            return await super().call_tool(name, arguments, context)
        except ToolError as error:
            why = error.__cause__
            if isinstance(why, ValidationError):
                raise ToolError(_misused(name, why)) from why
            known = [tool.name for tool in await self.list_tools()]
            if name not in known:
                raise ToolError(f"There is no tool {clean(name)}; there are {listed(known, 20)}.") from error
            raise


def _misused(tool: str, error: ValidationError) -> str:
    parts = []
    for each in error.errors(include_url=False):
        argument = ".".join(map(str, each["loc"])) or "the arguments"
        missing = each["type"] == "missing"
        said = each["msg"].removeprefix("Input ").removeprefix("String ").replace("should", "must", 1)
        parts.append(f"{argument} is missing" if missing else f"{argument} {said}")
    return f"{tool}: {clean('; '.join(parts), 400)}."


def server_of(knowledge: Knowledge) -> MCPServer[Any]:
    """The server, with all tools and resources, whatever is allowed."""
    try:
        release = version("whereabouts")
    except PackageNotFoundError:
        release = "0"
    server = Server("whereabouts", instructions=INSTRUCTIONS, version=release, log_level="WARNING")
    _questions(server, knowledge)
    _actions(server, knowledge)
    _resources(server, knowledge)
    return server


def _asked(knowledge: Knowledge, call: Callable[[Recall], Answer]) -> ToldAnswer:
    try:
        return told(knowledge.ask(lambda world: answered(world, call)))
    except WhereaboutsError as error:
        return refused(f"{clean(str(error), 400)}.".replace("..", "."))


def _questions(server: MCPServer[Any], knowledge: Knowledge) -> None:
    reading = ToolAnnotations(read_only_hint=True, open_world_hint=False)

    @server.tool(annotations=reading)
    def where_is(name: Name) -> ToldAnswer:
        """Where an object is now; with several that fit, the choices."""
        return _asked(knowledge, lambda world: questions.where_is(world, name))

    @server.tool(annotations=reading)
    def when_last_seen(name: Name) -> ToldAnswer:
        """When and where an object was seen last; the value is an ISO 8601 moment."""
        return _asked(knowledge, lambda world: questions.when_last_seen(world, name))

    @server.tool(annotations=reading)
    def history(name: Name) -> ToldAnswer:
        """Where an object was, and since when; the value is a list of [place, from, until], ISO 8601."""
        return _asked(knowledge, lambda world: questions.history(world, name))

    @server.tool(annotations=reading)
    def what_changed(since: Since) -> ToldAnswer:
        """What is elsewhere, new or gone since a moment; the value is {id: [place before, place now]}."""
        return _asked(knowledge, lambda world: questions.what_changed(world, since))

    @server.tool(annotations=reading)
    def what_is_missing() -> ToldAnswer:
        """What was there in the last week and is no longer; the value is a list of ids."""
        return _asked(knowledge, questions.what_is_missing)

    @server.tool(annotations=reading)
    def who_was_here(place: PlaceName = "", since: Since = "in the last 24 hours") -> ToldAnswer:
        """Which people were at a place since a moment, and what was moved meanwhile.

        The value is a list of [person, from, until, [objects]], ISO 8601.
        """
        return _asked(knowledge, lambda world: questions.who_was_here(world, place, since))

    @server.tool(annotations=reading)
    def ask(
        question: Annotated[str, Field(description="A question in plain English.", max_length=500)],
    ) -> ToldAnswer:
        """Any question that `whereabouts ask` understands; one that it does not is answered with what can be asked."""
        return _asked(knowledge, lambda world: questions.ask(world, question))


def _actions(server: MCPServer[Any], knowledge: Knowledge) -> None:
    acting = ToolAnnotations(read_only_hint=False, destructive_hint=True, open_world_hint=True)

    @server.tool(annotations=acting)
    async def find_object(name: Name, context: Context[Any, Any]) -> ToldAnswer:
        """Search for an object with the robot, driving to where it can be seen; tells of its progress.

        Takes minutes; cancelling the call stops the robot's search.
        """
        why = knowledge.refusal("find_object")
        return refused(why) if why else await _find(knowledge, name, context)

    @server.tool(annotations=acting)
    def verify_object(name: Name) -> ToldAnswer:
        """Have the robot look again at an object that is known, before anything else."""
        return _changed(knowledge, "verify_object", name, "")

    @server.tool(annotations=acting)
    def forget(name: Name) -> ToldAnswer:
        """Take an object out of the world for good; its history stays."""
        return _changed(knowledge, "forget", name, "")

    def relabel(
        name: Name,
        class_name: Annotated[str, Field(alias="class", description='The right class, such as "bowl".')],
    ) -> ToldAnswer:
        """Correct the class of an object."""
        return _changed(knowledge, "relabel", name, class_name)

    # The argument is called as a keyword of Python is, and can only be passed on by name.
    @wraps(relabel)
    def by_keyword(**given: str) -> ToldAnswer:
        return relabel(given["name"], given["class"])

    del by_keyword.__wrapped__
    by_keyword.__signature__ = signature(relabel, eval_str=True)  # type: ignore[attr-defined]
    server.tool(annotations=acting)(by_keyword)


def _changed(knowledge: Knowledge, tool: str, name: str, class_name: str) -> ToldAnswer:
    why = knowledge.refusal(tool)
    if why:
        return refused(why)
    named: list[str] = []

    def choose(world: Recall) -> Answer:
        named.append(one_present(world, name))
        return Answer("", tool, 1.0, iso(world.now))

    chosen = _asked(knowledge, choose)
    if not named:
        return chosen
    try:
        ok, sentence = knowledge.change(tool, named[0], class_name)
    except WhereaboutsError as error:
        return refused(clean(str(error), 400))
    return ToldAnswer(sentence=sentence, ok=ok, probability=float(ok), stamp=chosen.stamp, value=named[0])


async def _find(knowledge: Knowledge, name: str, context: Context[Any, Any]) -> ToldAnswer:
    """Search in a thread; progress is told from here, and cancelling this stops it."""
    loop = asyncio.get_running_loop()
    steps: asyncio.Queue[tuple[str, float]] = asyncio.Queue()
    stop = threading.Event()

    def say(words: str, probability: float) -> None:
        loop.call_soon_threadsafe(steps.put_nowait, (words, probability))

    task: asyncio.Future[Any] = loop.run_in_executor(None, knowledge.find, name, say, stop.is_set)
    count = 0
    try:
        while not task.done():
            waiting = asyncio.ensure_future(steps.get())
            await asyncio.wait({waiting, task}, return_when=asyncio.FIRST_COMPLETED)
            if waiting.done():
                count += 1
                words, probability = waiting.result()
                await context.report_progress(count, None, f"{words} (p = {probability:.2f})")
            else:
                waiting.cancel()
        done = task.result()
    except WhereaboutsError as error:
        return refused(clean(str(error), 400))
    finally:
        stop.set()
    stamp = iso(done.stamp) if done.stamp else ""
    return ToldAnswer(
        sentence=done.sentence,
        ok=done.ok,
        probability=done.probability,
        stamp=stamp,
        value=done.object or None,
    )


def _resources(server: MCPServer[Any], knowledge: Knowledge) -> None:
    @server.resource("whereabouts://world", name="world", mime_type="application/json")
    def world() -> str:
        """Every object: place, position (m, map frame), probabilities, stamps (ISO 8601)."""
        try:
            return json.dumps(knowledge.ask(world_record), ensure_ascii=False)
        except WhereaboutsError as error:
            return json.dumps({"error": str(error)})

    @server.resource("whereabouts://map", name="map", mime_type="image/png")
    def picture() -> bytes:
        """A picture of rooms, furniture and objects."""

        try:
            return knowledge.ask(map_picture)
        except WhereaboutsError as error:
            raise ResourceError(str(error)) from error


def world_record(world: Recall) -> dict[str, Any]:
    """The present as JSON-able data."""
    objects = []
    for item in world.present.values():
        [place] = world.words(item.position[None])
        objects.append(
            {
                "id": item.id,
                "class": item.most_probable("class"),
                "color": item.most_probable("color"),
                "place": None if item.lost else place or None,
                "position_m": item.position.tolist(),
                "probability": item.existence,
                "lost": item.lost,
                "last_seen": iso(item.last_seen),
            }
        )
    places = [
        {"name": place.name, "kind": place.kind, "polygon_m": place.polygon.tolist()}
        for place in world.places
    ]
    return {"stamp": iso(world.now), "frame": world.places.frame, "objects": objects, "places": places}


SIZE, DPI = 8.0, 110


def map_picture(world: Recall) -> bytes:
    """PNG of the home from above, in m; objects that are missing are left out."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Polygon

    figure = Figure(figsize=(SIZE, SIZE), dpi=DPI, layout="constrained")
    axes = figure.add_subplot()
    for place in world.places:
        room = place.kind == "room"
        color = "#f4f1ea" if room else "#d9c9a8"
        axes.add_patch(Polygon(place.polygon, facecolor=color, edgecolor="#777777", zorder=1 + (not room)))
        x, y = place.center
        axes.text(x, y, name_of(place.name), ha="center", va="center", size=8, color="#666666", zorder=3)
    for item in world.present.values():
        if item.lost or item.existence < 0.5:
            continue
        x, y, _ = item.position
        axes.plot(x, y, "o", color="#c0392b", zorder=4)
        axes.annotate(
            clean(item.id), (x, y), (4, 4), textcoords="offset points", size=8, zorder=5, parse_math=False
        )
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    axes.set_title(clock(world.now))
    drawn = BytesIO()
    figure.savefig(drawn, format="png")
    return drawn.getvalue()
