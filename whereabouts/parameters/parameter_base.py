"""What parameters of all nodes have in common, how they are described, and the models by the names of their nodes."""

from __future__ import annotations

import importlib
from dataclasses import fields
from typing import Any, ClassVar, Literal, Self, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic.fields import FieldInfo

from estimation.errors import InputError
from whereabouts.node_names import NODES
from whereabouts.system.state_files import StateFiles

Config = TypeVar("Config")


def setting(
    default: Any,
    description: str,
    *,
    unit: str = "",
    ge: float | None = None,
    le: float | None = None,
    fixed: bool = False,
) -> Any:
    """One parameter: its default, what it means, its unit and its inclusive range.

    fixed : it is read when the node is configured and cannot be changed while it runs.
    """
    extra: dict[str, Any] = {"unit": unit, "fixed": fixed}
    return Field(default, description=description, ge=ge, le=le, json_schema_extra=extra)


def setting_of(config: type, name: str) -> Any:
    """One setting of a library (`estimation.settings`) as a parameter; it is read at the start only."""
    item = next(item for item in fields(config) if item.name == name)
    about = item.metadata
    return setting(
        item.default, about["description"], unit=about["unit"], ge=about.get("low"), le=about.get("high"),
        fixed=True,
    )  # fmt: skip


class NodeParameters(BaseModel):
    """Parameters every node has.

    public : names of those that users set, at most twelve, in the order of files and pages; the rest is for experts.
    What several nodes have with one meaning (`SharedParameters`) is described once and not among them.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    public: ClassVar[tuple[str, ...]] = ()

    autostart: bool = setting(
        True, "the node configures and activates itself; false leaves that to a lifecycle manager", fixed=True
    )
    transform_timeout: float = setting(
        0.5,
        "a message waits for its transform until the stamps of its topic are this much later; then it is dropped",
        unit="s",
        ge=0.0,
        le=10.0,
    )
    input_reliability: Literal["best_effort", "reliable"] = setting(
        "best_effort",
        "best_effort for live sensors; reliable for replay and tests, with a deeper queue",
        fixed=True,
    )
    report_processed: bool = setting(
        False, "publish ~/processed for every input message, for lock-step replay", fixed=True
    )
    diagnostics_period: float = setting(
        1.0, "time between diagnostics", unit="s", ge=0.1, le=60.0, fixed=True
    )

    @model_validator(mode="after")
    def together(self) -> Self:
        """What is only known of all of them."""
        try:
            self.check()
        except InputError as error:
            raise ValueError(str(error)) from error
        return self

    def check(self) -> None:
        """Raises InputError where they do not fit together."""

    def config_of(self, kind: type[Config], **given: Any) -> Config:
        """A library's settings: those that are parameters, and what is given, on its defaults."""
        names = {item.name for item in fields(kind)} & type(self).model_fields.keys()  # type: ignore[arg-type]
        return kind(**{name: getattr(self, name) for name in names} | given)


class MapFrame(NodeParameters):
    """Of nodes that work in the map."""

    map_frame: str = setting(
        "map", "map frame of REP-105: does not drift, but may jump; of all that is stored", fixed=True
    )


class OdomFrame(NodeParameters):
    """Of nodes that follow something in the frame of odometry."""

    odom_frame: str = setting("odom", "odometry frame of REP-105: continuous, but drifts", fixed=True)


class BaseFrame(NodeParameters):
    """Of nodes that ask tf for the robot."""

    base_frame: str = setting("base_link", "frame of the robot", fixed=True)


class FileParameters(NodeParameters):
    """Of nodes that write files."""

    state_dir: str = setting(
        "",
        "folder of the files that services name; empty: $XDG_STATE_HOME/whereabouts or ~/.local/state/whereabouts",
        fixed=True,
    )
    allowed_folders: list[str] = setting(
        [""], "services may name absolute paths below these folders only; [''] allows none", fixed=True
    )

    @property
    def files(self) -> StateFiles:
        """What services may name."""
        return StateFiles(self.state_dir, self.allowed_folders)


class SharedParameters(FileParameters, BaseFrame, OdomFrame, MapFrame):
    """What several nodes have, with one meaning; a section `/**` of a parameter file sets it for all of them."""

    public = ("map_frame", "odom_frame", "base_frame")


def is_parameter_of_any(name: str) -> bool:
    """Whether some node of the suite has a parameter of that name."""
    return any(name in model_of(node).model_fields for node in NODES)


def expert_names(node: str) -> tuple[str, ...]:
    """Parameters that a node alone has and that are not public."""
    model = model_of(node)
    known = {*model.public, *SharedParameters.model_fields}
    return tuple(name for name in model.model_fields if name not in known)


def model_of(node: str) -> type[NodeParameters]:
    """Parameter model of a node by its name."""
    module = importlib.import_module(f"whereabouts.parameters.{node}")
    for name, item in vars(module).items():
        own = isinstance(item, type) and item.__module__ == module.__name__ and not name.startswith("_")
        if own and issubclass(item, NodeParameters):
            return item
    raise LookupError(f"whereabouts.parameters.{node} has no parameter model")


def extra(field: FieldInfo, name: str) -> Any:
    """`unit` or `fixed` of a field."""
    given = field.json_schema_extra
    return given.get(name) if isinstance(given, dict) else None


def bounds(field: FieldInfo) -> tuple[float | None, float | None]:
    """Inclusive lower and upper bound of a field, None where it has none."""
    lower = next((m.ge for m in field.metadata if hasattr(m, "ge")), None)
    upper = next((m.le for m in field.metadata if hasattr(m, "le")), None)
    return lower, upper


def allowed(field: FieldInfo) -> str:
    """What values a field takes, in words."""
    lower, upper = bounds(field)
    kind = getattr(field.annotation, "__name__", str(field.annotation)).replace("typing.", "")
    if options := get_args(field.annotation):
        listed = ", ".join(getattr(option, "__name__", str(option)) for option in options)
        kind = f"one of {listed}" if kind == "Literal" else f"{kind} of {listed}"
    unit = extra(field, "unit")
    span = "" if lower is None or upper is None else f" from {lower:g} to {upper:g}"
    return f"{kind}{span}{f' {unit}' if unit else ''}"


def explain(model: type[NodeParameters], problem: Any) -> str:
    """One validation problem as a sentence: name, value, allowed values."""
    name = str(problem["loc"][0]) if problem["loc"] else "parameters"
    field = model.model_fields.get(name)
    expected = f"{allowed(field)} expected" if field else problem["msg"]
    if problem["type"] == "value_error":
        expected = problem["msg"].removeprefix("Value error, ")
        if not problem["loc"]:
            return f"parameters: {expected}"
    return f"parameter {name}: {expected}, got {problem['input']!r}"
