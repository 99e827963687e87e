"""What can be wrong with a log: every message names the file, the place in it and what to do."""

from __future__ import annotations

from pathlib import Path

from estimation.errors import InputError


class UnreadableTypeError(Exception):
    """Messages of a type cannot be read: no definition, or one that they do not fit; the message says which."""


class LogError(InputError):
    """Base of all errors of reading and writing logs; `path` and `where` (line or byte offset, or "") say the place."""

    def __init__(self, path: Path | str, problem: str, where: str = "") -> None:
        self.path = Path(path)
        self.where = where
        place = f"{path}, {where}" if where else f"{path}"
        super().__init__(f"{place}: {problem}")


class LogNotFoundError(LogError):
    """There is no such file or directory, or it may not be read."""


class EmptyLogError(LogError):
    """The file exists and holds nothing."""


class UnknownFormatError(LogError):
    """Neither content nor name belongs to a format that can be read."""


class NothingRecognisedError(LogError):
    """The format was recognised, but no usable record was found to the end of the file."""


class DamagedLogError(LogError):
    """The file is broken at a place from which reading on is not possible."""


class OversizedLogError(DamagedLogError):
    """What is compressed unpacks to more than its limit."""


class TrajectoryError(LogError):
    """A trajectory file has a line that is not `stamp x y z qx qy qz qw`."""


class WriteError(LogError):
    """Nothing was written: the target cannot be made, or a record does not fit what was declared."""
