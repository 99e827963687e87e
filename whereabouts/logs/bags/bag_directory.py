"""rosbag2 directories, split and compressed bags, and bags packed in an archive, as one BagFile."""

from __future__ import annotations

import re
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path, PurePosixPath

import yaml
import zstandard

from whereabouts.logs.bags.mcap_file import McapFile
from whereabouts.logs.bags.rosbag1_file import Ros1File
from whereabouts.logs.bags.sqlite_file import SqliteFile
from whereabouts.logs.bags.storage import BagFile, Qos, Stored, Topic, parse_qos
from whereabouts.logs.bags.unpacking import UNPACKED_LIMIT, copy, unpack
from whereabouts.logs.format_detection import only_member, refuse_compressed_bag
from whereabouts.logs.formats.text import ZIP_MAGIC, TextSource, open_file
from whereabouts.logs.summary import Summary
from whereabouts.system.log_errors import DamagedLogError, LogNotFoundError, UnknownFormatError

METADATA = "metadata.yaml"
STORAGES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def open_bag(path: Path, summary: Summary, limit: int = UNPACKED_LIMIT) -> BagFile:
    """A ROS 1 or ROS 2 bag of any kind; damage found on the way goes into `summary`. limit : bytes it may unpack to.

    Raises LogNotFoundError, UnknownFormatError, DamagedLogError: as `open_log`.
    """
    if path.is_dir():
        return BagDirectory(path, summary, limit)
    return open_bag_file(path, summary, limit=limit)


def open_bag_file(
    path: Path, summary: Summary, shown: Path | None = None, limit: int = UNPACKED_LIMIT
) -> BagFile:
    """One file, told apart by its first bytes; `shown` is what messages call it."""
    with open_file(path) as stream:
        magic = stream.read(16)
    if magic.startswith(b"\x89MCAP"):
        return McapFile(path, summary, shown, limit)
    if magic.startswith(b"SQLite format 3"):
        return SqliteFile(path, summary, shown)
    if magic.startswith(b"#ROSBAG"):
        return Ros1File(path, summary, shown, limit)
    if magic.startswith(ZSTD_MAGIC):
        return _unpacked(path, summary, _inflate_zstd, limit)
    if magic.startswith(ZIP_MAGIC):
        return _unpacked(path, summary, _inflate_zip, limit)
    refuse_compressed_bag(shown or path, TextSource(path).head(16))
    problem = "is no bag: neither MCAP, sqlite3 nor ROS 1; `whereabouts convert` makes one of other logs"
    raise UnknownFormatError(shown or path, problem)


def _unpacked(
    path: Path, summary: Summary, inflate: Callable[[Path, Path, int], None], limit: int
) -> BagFile:
    """A bag inside a compressed file, on disk as long as it is open: bags need random access."""
    with tempfile.TemporaryDirectory(prefix="whereabouts-") as folder:
        unpacked = Path(folder) / "bag"
        inflate(path, unpacked, limit)
        return open_bag_file(unpacked, summary, path, limit)


def _inflate_zstd(path: Path, target: Path, limit: int) -> None:
    """A file cut short gives its beginning; the reader of that then says where it breaks off."""
    with path.open("rb") as source, target.open("wb") as sink:
        try:
            copy(
                zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True).read,
                sink,
                path,
                limit,
            )
        except zstandard.ZstdError as error:
            if not sink.tell():
                raise DamagedLogError(path, f"cannot be decompressed ({error})") from error


def _inflate_zip(path: Path, target: Path, limit: int) -> None:
    member = only_member(path)
    try:
        with zipfile.ZipFile(path) as archive, archive.open(member) as source, target.open("wb") as sink:
            copy(source.read, sink, path, limit)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, OSError, zlib.error) as error:
        raise DamagedLogError(path, f"member {member} cannot be unpacked ({error})") from error


class BagDirectory:
    """A rosbag2 directory: its files one after the other, each open only while it is read.

    Without metadata.yaml (a recorder that was killed writes none) the files are taken by their numbers.
    Raises UnknownFormatError: neither metadata.yaml nor a bag file; LogNotFoundError: a file that metadata.yaml names
    is missing; DamagedLogError: metadata.yaml cannot be used.
    """

    def __init__(self, path: Path, summary: Summary, limit: int = UNPACKED_LIMIT) -> None:
        self.path = path
        self._summary = summary
        self._limit = limit
        self._current: BagFile | None = None
        self._number = 0
        self._inflate: Callable[[bytes], bytes] | None = None
        self._recorded: dict[tuple[str, str], tuple[str, tuple[Qos, ...]]] = {}
        if (path / METADATA).is_file():
            self._files = self._described()
        else:
            self._files = self._found()
            summary.note(f"{path.name}: no {METADATA} (recorder killed), its files read by number", path.name)

    @property
    def progress(self) -> float:
        share = 0.0 if self._current is None else self._current.progress
        return min((self._number + share) / max(len(self._files), 1), 1.0)

    def close(self) -> None:
        if self._current is not None:
            self._current.close()

    def topics(self) -> list[Topic]:
        found: dict[tuple[str, str], Topic] = {}
        for file in self._each():
            for topic in file.topics():
                found.setdefault((topic.name, topic.type_name), self._completed(topic))
        return list(found.values())

    def messages(self) -> Iterator[Stored]:
        for file in self._each():
            # A split file declares its topics anew; a reader of the bag is to see each of them once.
            completed: dict[int, Topic] = {}
            for stored in file.messages():
                topic = completed.get(id(stored.topic))
                if topic is None:
                    topic = completed[id(stored.topic)] = self._completed(stored.topic)
                yield Stored(topic, stored.data, stored.log_time, stored.where)

    def _each(self) -> Iterator[BagFile]:
        for number, path in enumerate(self._files):
            self._number = number
            file = open_bag_file(path, self._summary, limit=self._limit)
            self._current = file
            try:
                yield file
            finally:
                file.close()
                self._current = None
        self._number = len(self._files)

    def _completed(self, topic: Topic) -> Topic:
        """The topic with what only metadata.yaml says: older files lack hash and QoS."""
        type_hash, qos = self._recorded.get((topic.name, topic.type_name), ("", ()))
        return replace(
            topic,
            type_hash=topic.type_hash or type_hash,
            qos=topic.qos or qos,
            to_cdr=self._inflate or topic.to_cdr,
        )

    def _found(self) -> list[Path]:
        files = [path for path in self.path.iterdir() if path.name.endswith(STORAGES)]
        if not files:
            raise UnknownFormatError(
                self.path, f"is no rosbag2 directory: neither {METADATA} nor a .mcap or .db3 file in it"
            )
        # `bag_10` comes after `bag_2`.
        return sorted(files, key=lambda path: (list(map(int, re.findall(r"\d+", path.name))), path.name))

    def _described(self) -> list[Path]:
        source = self.path / METADATA
        try:
            information = yaml.safe_load(source.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
            names = [PurePosixPath(str(name)).name for name in information["relative_file_paths"]]
            for entry in information.get("topics_with_message_count") or ():
                topic = entry["topic_metadata"]
                qos = parse_qos(topic.get("offered_qos_profiles") or "")
                self._recorded[topic["name"], topic["type"]] = topic.get("type_description_hash") or "", qos
        except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError) as error:
            problem = "is no rosbag2 metadata; without it the files beside it are read on their own"
            raise DamagedLogError(source, problem) from error
        compressed = str(information.get("compression_mode") or "none").lower() != "none"
        if compressed and information.get("compression_format") != "zstd":
            form = information.get("compression_format")
            raise UnknownFormatError(source, f"compression {form} is not known, zstd is")
        if compressed and str(information["compression_mode"]).lower() == "message":
            self._inflate = lambda data: unpack("zstd", data, self.path, self._limit)
        files = [self.path / name for name in names]
        missing = [file.name for file in files if not file.is_file()]
        if missing or not files:
            raise LogNotFoundError(self.path, f"files named in {METADATA} are missing: {', '.join(missing)}")
        return files
