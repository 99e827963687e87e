"""What a node reports about itself: rates, latencies, drops and its own health."""

from __future__ import annotations

import time
import traceback
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from estimation.filters.gaussians import repairs
from whereabouts.node_interfaces import DIAGNOSTICS
from whereabouts.nodes.messages.stamps import NANOSECONDS
from whereabouts.nodes.ros.inputs import Input
from whereabouts.nodes.ros.outputs import QUIET

if TYPE_CHECKING:
    from whereabouts.nodes.ros.base import SuiteNode

WARNING_PERIOD = 5.0
MOST_SILENCED = 1000  # kinds of complaints that are remembered


@dataclass
class Health:
    """A node's own judgement: a sentence, whether it is a warning, and named figures."""

    message: str = "ok"
    warning: bool = False
    figures: dict[str, object] = field(default_factory=dict)


class Complaints:
    """What a node warns of, in its log and here.

    count : of all warnings; last : the newest. defects : those of exceptions nobody expected.
    """

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self.count = 0
        self.defects = 0
        self.last = ""
        self._silent_until: dict[Any, float] = {}

    def alarm(self, text: str) -> None:
        """Warn, in the log and in diagnostics, each time."""
        self.count += 1
        self.last = text
        self._logger.warning(text)

    def complain(self, text: str, key: Any = None, defect: bool = False) -> None:
        """Warn, at most once in a while for each key; count always."""
        self.count += 1
        self.defects += defect
        self.last = text.splitlines()[0]
        now = time.monotonic()
        if now < self._silent_until.get(key or text, 0.0):
            return
        if len(self._silent_until) >= MOST_SILENCED:
            self._silent_until.clear()
        self._silent_until[key or text] = now + WARNING_PERIOD
        if defect:
            self._logger.error(text)
        else:
            self._logger.warning(text)

    def report_defect(self, where: str, error: Exception) -> None:
        """An exception nobody expected: said with its trace, counted, survived. The executor calls it, too."""
        trace = "".join(traceback.format_exception(error, limit=-4))
        text = f"{where}: internal error: {type(error).__name__}: {error}\n{trace}"
        self.complain(text, (where, "defect"), True)


class DiagnosticsPublisher:
    """Publishes one status per node on `/diagnostics`, at a fixed rate by the steady clock."""

    def __init__(self, node: SuiteNode) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, DIAGNOSTICS, 10, event_callbacks=QUIET)
        self._then = time.perf_counter()
        self._received: dict[str, int] = {}
        self._stopped: set[str] = set()
        self._troubles = 0

    def publish(self) -> None:
        """Publish now, and begin a new interval for rates."""
        now = time.perf_counter()
        interval, self._then = now - self._then, now
        # Every node has inputs from the moment it is configured; before that it has nothing to judge itself by.
        health = self._health()
        if silent := self._silent(now):
            health.warning, health.message = True, "; ".join([silent, health.message])
        figures = dict(health.figures)
        for item in self._node.inputs:
            item.watch_publishers()
            before = self._received.get(item.topic, 0)
            self._received[item.topic] = item.counts.received
            clock = self._node.time.clocks.sources.get(item.topic)
            if clock is not None:
                figures |= {f"{item.topic} behind [s]": clock.lag, f"{item.topic} held back": len(clock.held)}
            figures |= _input_figures(item, (item.counts.received - before) / max(interval, 1e-6))
        figures["new runs"] = self._node.epoch
        if self._node.last_run:
            figures["last new run"] = self._node.last_run
        figures["internal errors"] = self._node.complaints.defects
        if repairs.count:
            figures["covariances repaired after rounding"] = repairs.count
        message = DiagnosticArray(status=[self._status(health, figures)])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)

    def _silent(self, now: float) -> str:
        """Which inputs have stopped, also said in the log as they do; a replay may wait for something."""
        heard = self._node.inputs if self._node.active and not self._node.replayed else ()
        since = {item.topic: item.silence(now) for item in heard if item.gaps.stopped(item.silence(now))}
        said = {
            topic: f"nothing has come on {topic} for {silent / NANOSECONDS:.0f} s"
            for topic, silent in since.items()
        }
        for topic in said.keys() - self._stopped:
            self._node.complaints.alarm(said[topic])
        self._stopped = set(said)
        return "; ".join(said.values())

    def _health(self) -> Health:
        if not self._node.inputs:
            return Health("not configured")
        try:
            return self._node.health()
        except Exception as error:
            self._node.report_defect("health", error)
            return Health("cannot determine its health", warning=True)

    def _status(self, health: Health, figures: dict[str, object]) -> DiagnosticStatus:
        complaints = self._node.complaints
        troubles = complaints.count
        fresh, self._troubles = troubles > self._troubles, troubles
        level, text = DiagnosticStatus.OK, health.message
        if not self._node.active and self._node.inputs:
            text = "inactive"
        if health.warning or fresh:
            level = DiagnosticStatus.WARN
        if fresh and not health.warning:
            text = complaints.last
        if complaints.defects and fresh:
            level = DiagnosticStatus.ERROR
        if contradictions := self._node.transforms.contradictions():
            level, text = DiagnosticStatus.ERROR, "; ".join(contradictions)
        return DiagnosticStatus(
            level=level,
            name=self._node.get_fully_qualified_name().lstrip("/"),
            message=text,
            hardware_id="whereabouts",
            values=[KeyValue(key=key, value=_text(value)) for key, value in figures.items()],
        )


def _input_figures(item: Input, rate: float) -> dict[str, object]:
    counts, name = item.counts, item.topic
    figures: dict[str, object] = {
        f"{name} rate [Hz]": rate,
        f"{name} received": counts.received,
        f"{name} used": counts.used,
        f"{name} lost": counts.missing,
        f"{name} dropped": counts.dropped,
        f"{name} late": counts.late,
        f"{name} stamp gaps": counts.stamp_gaps,
        f"{name} repeated stamps": counts.repeated_stamps,
        f"{name} while inactive": counts.inactive,
    }
    figures |= {f"{name} dropped, {reason}": count for reason, count in counts.drops.items()}
    if item.latencies:
        p50, p99 = np.percentile(item.latencies, [50, 99]) * 1e3
        figures |= {f"{name} latency p50 [ms]": float(p50), f"{name} latency p99 [ms]": float(p99)}
    return figures


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
