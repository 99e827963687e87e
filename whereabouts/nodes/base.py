"""The name by which users import `whereabouts.nodes.ros.base`."""

from whereabouts.nodes.ros.base import HOUSEKEEPING_PERIOD, NodeType, SuiteNode, exit_with, run_node, start
from whereabouts.nodes.ros.diagnostics import MOST_SILENCED, WARNING_PERIOD
from whereabouts.nodes.ros.qos import LATCHED, TF_QOS, TF_STATIC_QOS

__all__ = [
    "HOUSEKEEPING_PERIOD", "LATCHED", "MOST_SILENCED", "TF_QOS", "TF_STATIC_QOS", "WARNING_PERIOD",
    "NodeType", "SuiteNode", "exit_with", "run_node", "start",
]  # fmt: skip
