"""Readers and writers of robot logs. Knows no ROS installation."""

from whereabouts.log_errors import (
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
from whereabouts.messages.records import (
    CloudRecord,
    MessageRecord,
    OdometryRecord,
    Record,
    ScanRecord,
    TransformRecord,
)

from .carmen import CarmenLog
from .conversion import Conversion, convert_log
from .g2o import Edge, G2oGraph, G2oLog, read_g2o, write_g2o
from .log import Log
from .opening import open_log
from .ros import RawLog, RawMessage, RosLog, open_raw
from .storage import Qos, Topic
from .summary import Summary
from .tum import Trajectory, TumWriter, read_tum, write_tum
from .writer import McapWriter

__all__ = [
    "CarmenLog",
    "CloudRecord",
    "Conversion",
    "DamagedLogError",
    "Edge",
    "EmptyLogError",
    "G2oGraph",
    "G2oLog",
    "Log",
    "LogError",
    "LogNotFoundError",
    "McapWriter",
    "MessageRecord",
    "NothingRecognisedError",
    "OdometryRecord",
    "OversizedLogError",
    "Qos",
    "RawLog",
    "RawMessage",
    "Record",
    "RosLog",
    "ScanRecord",
    "Summary",
    "Topic",
    "Trajectory",
    "TrajectoryError",
    "TransformRecord",
    "TumWriter",
    "UnknownFormatError",
    "WriteError",
    "convert_log",
    "open_log",
    "open_raw",
    "read_g2o",
    "read_tum",
    "write_g2o",
    "write_tum",
]
