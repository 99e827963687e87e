"""Readers and writers of robot logs. Knows no ROS installation."""

from .carmen import CarmenLog
from .errors import (
    DamagedLogError,
    EmptyLogError,
    LogError,
    LogNotFoundError,
    NothingRecognisedError,
    TrajectoryError,
    UnknownFormatError,
    WriteError,
)
from .log import Log
from .opening import open_log
from .records import (
    CloudRecord,
    MessageRecord,
    OdometryRecord,
    Record,
    ScanRecord,
    TransformRecord,
)
from .summary import Summary
from .tum import Trajectory, TumWriter, read_tum, write_tum

__all__ = [
    "CarmenLog",
    "CloudRecord",
    "DamagedLogError",
    "EmptyLogError",
    "Log",
    "LogError",
    "LogNotFoundError",
    "MessageRecord",
    "NothingRecognisedError",
    "OdometryRecord",
    "Record",
    "ScanRecord",
    "Summary",
    "Trajectory",
    "TrajectoryError",
    "TransformRecord",
    "TumWriter",
    "UnknownFormatError",
    "WriteError",
    "open_log",
    "read_tum",
    "write_tum",
]
