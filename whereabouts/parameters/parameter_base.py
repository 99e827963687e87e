"""What parameters of all nodes have in common, and how a parameter is described."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field


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


class NodeParameters(BaseModel):
    """Parameters every node has.

    public : names of those that users set, at most twelve, in the order of files and pages; the rest is for experts.
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


class FileParameters(NodeParameters):
    """Parameters of nodes that write files."""

    state_dir: str = setting(
        "",
        "folder of the files that services name; empty: $XDG_STATE_HOME/whereabouts or ~/.local/state/whereabouts",
        fixed=True,
    )
    allowed_folders: list[str] = setting(
        [""], "services may name absolute paths below these folders only; [''] allows none", fixed=True
    )


class FrameParameters(NodeParameters):
    """Parameters of nodes that work in the frames of REP-105."""

    base_frame: str = setting("base_link", "frame of the robot", fixed=True)
    odom_frame: str = setting("odom", "odometry frame: continuous, but drifts", fixed=True)
    publish_tf: bool = setting(True, "publish the node's transform on tf")
