"""ROS 2 bags: both storages, split, compressed, bare, without metadata, and with a killed recorder."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3

import numpy as np
import pytest
import yaml
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as RawWriter
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from whereabouts.logs import (
    DamagedLogError,
    EmptyLogError,
    LogError,
    LogNotFoundError,
    NothingRecognisedError,
    Topic,
    UnknownFormatError,
    open_log,
    open_raw,
)
from whereabouts.logs.bags.ros_types import decoded
from whereabouts.system.log_errors import UnreadableTypeError

KINDS = [
    (StoragePlugin.SQLITE3, CompressionMode.NONE),
    (StoragePlugin.SQLITE3, CompressionMode.FILE),
    (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    (StoragePlugin.MCAP, CompressionMode.NONE),
    (StoragePlugin.MCAP, CompressionMode.FILE),
    (StoragePlugin.MCAP, CompressionMode.MESSAGE),
    (StoragePlugin.MCAP, CompressionMode.STORAGE),
]


def content(messages):
    return [(m.name, m.type_name, m.log_time, m.data) for m in messages]


def expected(path):
    """The same by rosbags' own reader."""
    with AnyReader([path]) as reader:
        return [(c.topic, c.msgtype, time, bytes(data)) for c, time, data in reader.messages()]


def declare(writer, store, topic="/chatter", kind="std_msgs/msg/String"):
    text = store.generate_msgdef(kind, ros_version=2)[0].encode()
    return writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", text))


def write_mcap(path, store, messages, times, compression=CompressionType.ZSTD, finish=True, **options):
    """A file by the mcap package, finished or left as a killed recorder leaves it."""
    with path.open("wb") as stream:
        writer = RawWriter(stream, compression=compression, chunk_size=2000, **options)
        writer.start(profile="ros2")
        channel = declare(writer, store)
        for message, time in zip(messages, times, strict=True):
            writer.add_message(
                channel, time, bytes(store.serialize_cdr(message, "std_msgs/msg/String")), time
            )
        if finish:
            writer.finish()
    return path


@pytest.mark.parametrize(("plugin", "mode"), KINDS)
def test_every_storage_and_compression(tmp_path, bag2, jazzy, entries, plugin, mode):
    path = bag2(tmp_path / "bag", entries(jazzy), plugin, mode)
    with open_raw(path) as raw:
        assert content(raw) == expected(path)
        hashes = {topic.type_name: topic.type_hash for topic in raw.topics}
    for name, value in hashes.items():
        assert value == jazzy.store.hash_rihs01(name)
    with open_log(path) as log:
        assert len(list(log)) == 90
        assert log.summary.records == {"wheel_odom": 30, "tf": 30, "scan": 30}
        assert not log.summary.notes


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_bare_file_and_a_directory_without_metadata(tmp_path, bag2, jazzy, entries, plugin):
    path = bag2(tmp_path / "bag", entries(jazzy), plugin)
    reference = expected(path)
    (file,) = (entry for entry in path.iterdir() if entry.suffix in (".mcap", ".db3"))
    assert content(open_raw(file)) == reference
    (path / "metadata.yaml").unlink()
    raw = open_raw(path)
    assert content(raw) == reference
    assert any("no metadata.yaml" in note for note in raw.summary.notes)


@pytest.mark.parametrize("described", [True, False])
def test_a_split_bag_is_read_in_the_order_of_its_files(tmp_path, bag2, jazzy, described):
    whole = tmp_path / "whole"
    whole.mkdir()
    names = []
    for part in range(12):
        made = [
            ("/chatter", "std_msgs/msg/String", (part * 10 + i) * 1000 + 1, jazzy.string(f"{part} {i}"))
            for i in range(10)
        ]
        piece = bag2(tmp_path / f"part{part}", made)
        names.append(f"whole_{part}.mcap")
        shutil.move(piece / f"part{part}.mcap", whole / names[-1])
    if described:
        information = yaml.safe_load((tmp_path / "part0" / "metadata.yaml").read_text())
        information["rosbag2_bagfile_information"]["relative_file_paths"] = names
        (whole / "metadata.yaml").write_text(yaml.safe_dump(information))
    raw = open_raw(whole)
    assert [message.log_time for message in raw] == [i * 1000 + 1 for i in range(120)]
    assert raw.progress == 1.0
    assert [topic.name for topic in raw.topics] == ["/chatter"]


def test_a_split_bag_whose_last_file_is_cut(tmp_path, bag2, jazzy, entries):
    path = bag2(tmp_path / "bag", entries(jazzy))
    shutil.copy(path / "bag.mcap", path / "bag_1.mcap")
    (path / "bag.mcap").rename(path / "bag_0.mcap")
    (path / "metadata.yaml").unlink()
    cut = (path / "bag_1.mcap").read_bytes()
    (path / "bag_1.mcap").write_bytes(cut[: len(cut) - 100])
    raw = open_raw(path)
    assert len(list(raw)) == 240
    assert any(note.startswith("bag_1.mcap: not finished") for note in raw.summary.notes)


@pytest.mark.parametrize("version", [8, 9])
def test_offered_qos_is_handed_on(tmp_path, bag2, jazzy, entries, version):
    never = QosTime(9223372036, 854775807)
    offered = Qos(
        QosHistory.KEEP_LAST,
        7,
        QosReliability.BEST_EFFORT,
        QosDurability.TRANSIENT_LOCAL,
        never,
        never,
        QosLiveliness.AUTOMATIC,
        never,
        False,
    )
    for plugin in (StoragePlugin.SQLITE3, StoragePlugin.MCAP):
        path = bag2(tmp_path / plugin.name, entries(jazzy, 2), plugin, qos=[offered])
        for topic in open_raw(path).topics:
            (qos,) = topic.qos
            assert (qos.history, qos.depth) == ("keep_last", 7)
            assert (qos.reliability, qos.durability) == ("best_effort", "transient_local")


def test_messages_come_by_log_time_even_where_chunks_overlap(tmp_path, jazzy):
    times = [int(t) for t in np.random.default_rng(1).permutation(400)]
    path = write_mcap(tmp_path / "a.mcap", jazzy.store, [jazzy.string("x" * 40)] * 400, times)
    assert [message.log_time for message in open_raw(path)] == sorted(times)


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
def test_files_without_index_or_summary(tmp_path, jazzy, compression, chunked):
    messages = [jazzy.string(f"{i} " * 20) for i in range(200)]
    path = write_mcap(
        tmp_path / "a.mcap",
        jazzy.store,
        messages,
        range(200),
        compression,
        use_chunking=chunked,
        index_types=IndexType.NONE,
        repeat_channels=False,
        repeat_schemas=False,
        use_statistics=False,
        use_summary_offsets=False,
    )
    raw = open_raw(path)
    assert [message.log_time for message in raw] == list(range(200))
    assert not raw.summary.notes


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_killed_recorder_leaves_all_whole_chunks(tmp_path, jazzy, compression):
    messages = [jazzy.string(f"{i} " * 20) for i in range(200)]
    path = write_mcap(tmp_path / "a.mcap", jazzy.store, messages, range(200), compression, finish=False)
    raw = open_raw(path)
    times = [message.log_time for message in raw]
    assert times == list(range(len(times)))
    assert 150 < len(times) < 200  # the chunk being filled was never written
    assert any(
        "not finished by its recorder, read up to the last whole chunk" in n for n in raw.summary.notes
    )
    assert [topic.name for topic in raw.topics] == ["/chatter"]


@pytest.mark.parametrize("chunked", [True, False])
def test_a_file_cut_at_any_place(tmp_path, jazzy, chunked):
    """Whatever the place, what comes is a beginning of the whole, and that it was cut is said."""
    messages = [jazzy.string(f"{i} " * 9) for i in range(120)]
    whole = write_mcap(tmp_path / "a.mcap", jazzy.store, messages, range(120), use_chunking=chunked)
    size = whole.stat().st_size
    data = whole.read_bytes()
    cut = tmp_path / "cut.mcap"
    longest = 0
    for end in sorted({*range(1, size, 97), *range(size - 60, size)}):
        cut.write_bytes(data[:end])
        try:
            raw = open_raw(cut)
            times = [message.log_time for message in raw]
        except LogError:
            assert end < 16
            continue
        assert times == list(range(len(times)))
        assert raw.summary.notes
        assert len(times) >= longest
        longest = len(times)
    assert longest == 120


def test_flipped_bits_cost_a_chunk_at_most(tmp_path, jazzy):
    messages = [jazzy.string(f"{i} " * 20) for i in range(200)]
    path = write_mcap(tmp_path / "a.mcap", jazzy.store, messages, range(200))
    data = path.read_bytes()
    generator = np.random.default_rng(4)
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    first = summary.chunk_indexes[0]
    inside = range(first.chunk_start_offset + 60, first.chunk_start_offset + first.chunk_length)
    for place in generator.choice(list(inside), 20, replace=False):
        damaged = bytearray(data)
        damaged[place] ^= 0x5A
        path.write_bytes(damaged)
        raw = open_raw(path)
        times = [message.log_time for message in raw]
        assert times == list(range(200 - len(times), 200))
        (remark,) = raw.summary.skipped.values()
        assert remark.first == f"byte {first.chunk_start_offset}"


def test_random_damage_never_escapes_the_error_family(tmp_path, bag2, jazzy, entries):
    generator = np.random.default_rng(8)
    for plugin, name in ((StoragePlugin.MCAP, "bag.mcap"), (StoragePlugin.SQLITE3, "bag.db3")):
        source = bag2(tmp_path / plugin.name / "bag", entries(jazzy, 12), plugin) / name
        data = source.read_bytes()
        for _ in range(25):
            damaged = bytearray(data)
            for place in generator.integers(0, len(data), 30):
                damaged[place] = generator.integers(0, 256)
            path = tmp_path / name
            path.write_bytes(damaged)
            with contextlib.suppress(LogError), open_log(path) as log:
                for _ in log:
                    pass


def test_a_killed_recorders_journal_is_read(tmp_path, bag2, jazzy, entries):
    path = bag2(tmp_path / "bag", entries(jazzy, 5), StoragePlugin.SQLITE3) / "bag.db3"
    database = sqlite3.connect(path)
    database.execute("PRAGMA journal_mode=WAL")
    database.execute("PRAGMA wal_autocheckpoint=0")
    database.execute(
        "INSERT INTO messages SELECT NULL, topic_id, timestamp + 1000000000000, data FROM messages"
    )
    database.commit()
    copied = tmp_path / "killed.db3"
    shutil.copy(path, copied)
    shutil.copy(f"{path}-wal", f"{copied}-wal")
    database.close()
    assert len(list(open_raw(copied))) == 40


def test_an_old_database_without_definitions_takes_jazzys(tmp_path, bag2, jazzy, entries):
    path = bag2(tmp_path / "bag", entries(jazzy, 5), StoragePlugin.SQLITE3) / "bag.db3"
    database = sqlite3.connect(path)
    for statement in (
        "DROP TABLE schema",
        "DROP TABLE metadata",
        "DROP TABLE message_definitions",
        "ALTER TABLE topics DROP COLUMN type_description_hash",
        "ALTER TABLE topics DROP COLUMN offered_qos_profiles",
    ):
        database.execute(statement)
    database.commit()
    database.close()
    log = open_log(path)
    assert len(list(log)) == 15
    assert open_raw(path).topics[0].qos == ()


def test_an_unknown_type_is_a_counted_skip(tmp_path, jazzy):
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = RawWriter(stream)
        writer.start(profile="ros2")
        good = declare(writer, jazzy.store)
        schemas = {
            "bad": writer.register_channel(
                "/bad", "cdr", writer.register_schema("a/msg/B", "ros2msg", b"float32 x[")
            ),
            "json": writer.register_channel(
                "/json", "json", writer.register_schema("a/msg/C", "ros2msg", b"")
            ),
            "none": writer.register_channel("/none", "cdr", 0),
        }
        data = bytes(jazzy.store.serialize_cdr(jazzy.string("x"), "std_msgs/msg/String"))
        for channel in (good, *schemas.values()):
            writer.add_message(channel, 5, data, 5)
        writer.finish()
    log = open_log(path, topics=["chatter", "bad", "json", "none"])
    assert [record.topic for record in log] == ["chatter"]
    assert log.summary.skipped_count == 3
    assert {
        name for name in ("/bad", "/json", "/none") for r in log.summary.skipped if r.startswith(name)
    } == {
        "/bad",
        "/json",
        "/none",
    }


def test_bytes_may_follow_a_message_and_none_may_be_missing(jazzy):
    kind = "std_msgs/msg/String"
    data = bytes(jazzy.store.serialize_cdr(jazzy.string("there"), kind))
    topic = Topic("/a", kind)
    assert decoded(topic, data).data == decoded(topic, data + bytes(20)).data == "there"
    for wrong in (b"", data[:4], data[:7], data[:-2], b"\0\7" + data[2:]):
        with pytest.raises(UnreadableTypeError):
            decoded(topic, wrong)


def test_what_is_no_bag(tmp_path, bag2, jazzy, entries):
    with pytest.raises(LogNotFoundError, match="nowhere"):
        open_log(tmp_path / "nowhere")
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "a.clf").write_text("ODOM 0 0 0 0 0 0 1 h 1\n")
    with pytest.raises(UnknownFormatError, match="whereabouts convert"):
        open_raw(tmp_path / "a.clf")
    with pytest.raises(EmptyLogError, match="empty"):
        open_log(tmp_path / "empty.mcap")
    (tmp_path / "directory").mkdir()
    with pytest.raises(UnknownFormatError, match=r"metadata\.yaml"):
        open_log(tmp_path / "directory")
    (tmp_path / "image.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    with pytest.raises(UnknownFormatError, match="none of the readable formats"):
        open_log(tmp_path / "image.png")
    sqlite3.connect(tmp_path / "other.db3").execute("CREATE TABLE t (a)").connection.close()
    with pytest.raises(DamagedLogError, match="rosbag2 database"):
        open_log(tmp_path / "other.db3")
    path = bag2(tmp_path / "bag", entries(jazzy, 2))
    (path / "bag.mcap").rename(path / "elsewhere.mcap")
    with pytest.raises(LogNotFoundError, match=r"bag\.mcap"):
        open_log(path)
    (path / "metadata.yaml").write_text("a: [")
    with pytest.raises(DamagedLogError, match="metadata"):
        open_log(path)


def test_a_bag_without_messages_is_an_error_when_read(tmp_path, jazzy):
    path = write_mcap(tmp_path / "a.mcap", jazzy.store, [], [])
    with pytest.raises(NothingRecognisedError):
        list(open_log(path))


def test_a_zstd_file_cut_short(tmp_path, bag2, jazzy, entries):
    path = bag2(tmp_path / "bag", entries(jazzy, 200), StoragePlugin.MCAP) / "bag.mcap"
    packed = zstandard.ZstdCompressor().compress(path.read_bytes())
    cut = tmp_path / "cut.mcap.zstd"
    cut.write_bytes(packed[: len(packed) - 40])
    with contextlib.suppress(LogError), open_raw(cut) as raw:
        for _ in raw:
            pass
        assert raw.summary.notes
