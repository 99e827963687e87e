"""Readers and writers of robot logs. Knows no ROS installation."""

from whereabouts.logs.bags.ros import RawLog, RawMessage, RosLog, open_raw
from whereabouts.logs.bags.storage import Qos, Topic
from whereabouts.logs.formats.carmen import CarmenLog
from whereabouts.logs.formats.g2o import G2oLog
from whereabouts.logs.formats.tum import Trajectory, read_tum, write_tum
from whereabouts.logs.log import Log
from whereabouts.logs.log_conversion import Conversion, convert_log
from whereabouts.logs.opening import open_log
from whereabouts.logs.summary import Summary
from whereabouts.logs.writer import McapWriter
from whereabouts.messages.records import (
    CloudRecord,
    MessageRecord,
    OdometryRecord,
    Record,
    ScanRecord,
    TransformRecord,
)
from whereabouts.system.log_errors import (
    DamagedLogError,
    EmptyLogError,
    LogError,
    LogNotFoundError,
    NothingRecognisedError,
    OversizedLogError,
    TrajectoryError,
    UnknownFormatError,
    WriteError,
)

__all__ = [
    "CarmenLog", "CloudRecord", "Conversion", "DamagedLogError", "EmptyLogError", "G2oLog",
    "Log", "LogError", "LogNotFoundError", "McapWriter", "MessageRecord",
    "NothingRecognisedError", "OdometryRecord", "OversizedLogError", "Qos", "RawLog", "RawMessage",
    "Record", "RosLog", "ScanRecord", "Summary", "Topic", "Trajectory", "TrajectoryError",
    "TransformRecord", "UnknownFormatError", "WriteError", "convert_log", "open_log",
    "open_raw", "read_tum", "write_tum",
]  # fmt: skip
