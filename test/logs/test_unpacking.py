"""What is compressed is unpacked up to a limit: of every format, in memory and on disk."""

from __future__ import annotations

import bz2
import gzip
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from whereabouts.logs import OversizedLogError, UnknownFormatError, open_log, open_raw
from whereabouts.logs.bags.unpacking import UNPACKED_LIMIT, unpack

MUCH = bytes(300 << 20)
LINES = b"PARAM robot_frontlaser_offset 0.0 0 host 0\n" * 100_000


def mcap(compression: CompressionType, zeros: int) -> bytes:
    file = BytesIO()
    writer = Writer(file, compression=compression, chunk_size=1 << 40)
    writer.start()
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
    channel = writer.register_channel("/chatter", "cdr", schema)
    writer.add_message(channel, 1, bytes(zeros), 1)
    writer.finish()
    return file.getvalue()


def rosbag1(compression: bytes, packed: bytes, size: int) -> bytes:
    def record(fields: dict[bytes, bytes], data: bytes) -> bytes:
        head = b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k + b"=" + v for k, v in fields.items())
        return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data

    counts = {b"index_pos": bytes(8), b"conn_count": bytes(4), b"chunk_count": bytes(4)}
    chunk = {b"op": b"\x05", b"compression": compression, b"size": struct.pack("<I", size)}
    return b"#ROSBAG V2.0\n" + record({b"op": b"\x03", **counts}, bytes(4)) + record(chunk, packed)


def zipped(name: str, content: bytes) -> bytes:
    file = BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content)
    return file.getvalue()


FILES: dict[str, Callable[[], bytes]] = {
    "zstd.mcap": lambda: mcap(CompressionType.ZSTD, len(MUCH)),
    "lz4.mcap": lambda: mcap(CompressionType.LZ4, len(MUCH)),
    "lz4.bag": lambda: rosbag1(b"lz4", lz4.frame.compress(MUCH), len(MUCH)),
    "bz2.bag": lambda: rosbag1(b"bz2", bz2.compress(MUCH), len(MUCH)),
    "whole.mcap.zstd": lambda: zstandard.compress(MUCH),
    "log.clf.gz": lambda: gzip.compress(LINES),
    "log.clf.bz2": lambda: bz2.compress(LINES),
    "log.zip": lambda: zipped("log.clf", LINES),
    "bag.zip": lambda: zipped("bag.mcap", MUCH),
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_unpacks_to_too_much_is_named_with_the_limit(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(FILES[name]())
    assert path.stat().st_size < 3 << 20
    tracemalloc.start()
    try:
        with (
            pytest.raises(OversizedLogError, match=rf"{name}.*: unpacks to more than 1 MiB, the limit"),
            open_log(path, unpacked_limit=1 << 20) as log,
        ):
            list(log)
        assert tracemalloc.get_traced_memory()[1] < 64 << 20
    finally:
        tracemalloc.stop()


def test_chunks_and_messages_have_a_limit_of_their_own(tmp_path: Path) -> None:
    path = tmp_path / "zstd.mcap"
    path.write_bytes(FILES["zstd.mcap"]())
    with pytest.raises(OversizedLogError, match="more than 256 MiB"), open_raw(path) as raw:
        list(raw)
    with pytest.raises(OversizedLogError, match="more than 256 MiB"):
        unpack("zstd", zstandard.compress(MUCH), path, UNPACKED_LIMIT)


@pytest.mark.parametrize("form", ["zstd", "lz4", "bz2"])
def test_what_is_exactly_as_large_as_the_limit_is_read(form: str) -> None:
    pack = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "bz2": bz2.compress}[form]
    data = bytes(range(256)) * 40
    assert unpack(form, pack(data), Path("x"), len(data)) == data
    with pytest.raises(OversizedLogError):
        unpack(form, pack(data), Path("x"), len(data) - 1)


@pytest.mark.parametrize(("name", "pack"), [("x.mcap.gz", gzip.compress), ("x.mcap.bz2", bz2.compress)])
@pytest.mark.parametrize("reader", [open_log, open_raw])
def test_a_compressed_bag_is_to_be_unpacked_first(
    tmp_path: Path, reader: Callable[[Path], object], name: str, pack: Callable[[bytes], bytes]
) -> None:
    path = tmp_path / name
    path.write_bytes(pack(mcap(CompressionType.NONE, 100)))
    with pytest.raises(UnknownFormatError, match=r"unpack it first"):
        reader(path)
