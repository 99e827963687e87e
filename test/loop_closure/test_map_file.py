"""Map files that are not as they were written: each ends in one sentence, never in a traceback or a map."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimation.errors import InputError
from loop_closure.maps.map_file import is_map, read_map, write_map
from loop_closure.slam.trajectory import Slam

Arrays = dict[str, Any]
COUNT = 4


def good() -> Arrays:
    """Clouds at four places in a row, an edge between neighbours and one closure."""
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    poses[:, 0, 3] = np.arange(COUNT)
    step = poses[1]
    rng = np.random.default_rng(0)
    return {
        "about": np.array(json.dumps({"kind": "whereabouts.map", "format": 1, "keyframes": COUNT})),
        "stamps": np.arange(COUNT, dtype=float),
        "odometry": poses.copy(),
        "paths": np.arange(COUNT, dtype=float),
        "poses": poses,
        "ends": np.array([(0, 1, 0), (1, 2, 0), (2, 3, 0), (0, 3, 1)]),
        "motions": np.stack([step, step, step, poses[3]]),
        "covariances": np.tile(1e-4 * np.eye(6), (4, 1, 1)),
        "breaks": np.zeros((0, 2)),
        "closures": np.array([(0, 3, 5.0, 0.9)]),
        "points": rng.uniform(-5.0, 5.0, (40, 3)).astype(np.float32),
        "counts": np.full(COUNT, 10),
    }


def scans() -> Arrays:
    made = good()
    flat = np.column_stack([np.arange(COUNT), np.zeros((COUNT, 2))]).astype(float)
    made |= {"odometry": flat, "poses": flat, "motions": np.tile((1.0, 0.0, 0.0), (4, 1))}
    made |= {"covariances": np.tile(1e-4 * np.eye(3), (4, 1, 1)), "ranges": np.full(40, 2.0, np.float32)}
    made["scans"] = np.tile((10.0, -1.0, 0.2, 0.1, 30.0, 0.0), (COUNT, 1))
    del made["points"], made["counts"]
    return made


def packed(arrays: Arrays) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def changed(name: str, place: Any, value: Any, base: Callable[[], Arrays] = good) -> Callable[[], bytes]:
    def make() -> bytes:
        made = base()
        made[name] = made[name].astype(float)
        made[name][place] = value
        return packed(made)

    return make


def replaced(name: str, value: Any, base: Callable[[], Arrays] = good) -> Callable[[], bytes]:
    return lambda: packed({**base(), name: np.array(value)})


def about(**changes: Any) -> Callable[[], bytes]:
    return replaced(
        "about", json.dumps({"kind": "whereabouts.map", "format": 1, "keyframes": COUNT} | changes)
    )


def member(header: bytes) -> Callable[[], bytes]:
    """An archive whose `stamps` claims what it is not."""

    def make() -> bytes:
        file = io.BytesIO(packed(good()))
        out = io.BytesIO()
        with zipfile.ZipFile(file) as old, zipfile.ZipFile(out, "w") as new:
            for info in old.infolist():
                data = old.read(info)
                if info.filename == "stamps.npy":
                    text = header.ljust(117) + b"\n"
                    data = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + data[128:]
                new.writestr(info.filename, data)
        return out.getvalue()

    return make


MALFORMED: dict[str, Callable[[], bytes]] = {
    "empty": lambda: b"",
    "text": lambda: b"image: home.pgm\nresolution: 0.05\n" * 50,
    "cut off": lambda: packed(good())[:-200],
    "pickle": lambda: packed({**good(), "stamps": np.array([{}] * COUNT, dtype=object)}),
    "enormous array": member(b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"),
    "negative array": member(b"{'descr': '<f8', 'fortran_order': False, 'shape': (-4,), }"),
    "code in the header": member(b"__import__('os').abort()"),
    "no archive of arrays": lambda: packed({"header": np.array("{}")}),
    "description is no object": replaced("about", "[1]"),
    "description nested": replaced("about", "[" * 100_000),
    "another kind": about(kind="whereabouts.intentions"),
    "newer": about(format=2),
    "format in words": about(format="one"),
    "other number of keyframes": about(keyframes=3),
    "missing poses": lambda: packed({k: v for k, v in good().items() if k != "poses"}),
    "text for numbers": replaced("paths", ["a"] * COUNT),
    "stamp not a number": changed("stamps", 1, np.nan),
    "stamp infinite": changed("stamps", 1, np.inf),
    "pose far away": changed("poses", (2, 0, 3), 1e19),
    "pose stretched": changed("poses", (2, 0, 0), 3.0),
    "pose mirrored": changed("odometry", (2, 2, 2), -1.0),
    "fewer poses": lambda: packed({**good(), "poses": good()["poses"][:3]}),
    "poses of a plane": lambda: packed({**good(), "poses": np.zeros((COUNT, 3))}),
    "edge to nowhere": changed("ends", (1, 1), 99),
    "edge from before": changed("ends", (1, 0), -1),
    "edge to itself": changed("ends", (1, 0), 2),
    "edge between halves": changed("ends", (1, 0), 0.5),
    "motion not a number": changed("motions", (0, 0, 3), np.nan),
    "covariance negative": changed("covariances", (0, 0, 0), -1.0),
    "covariance lopsided": changed("covariances", (0, 0, 1), 1.0),
    "break nowhere": replaced("breaks", [(77.0, 1.0)]),
    "closure nowhere": changed("closures", (0, 1), 50),
    "closures of three": replaced("closures", [(0.0, 1.0, 2.0)]),
    "point far away": changed("points", (0, 0), 1e20),
    "points flat": lambda: packed({**good(), "points": np.zeros((40, 2))}),
    "more points than counted": changed("counts", 0, 9),
    "counts negative": changed("counts", (slice(2),), (-10, 30)),
    "beams missing": changed("scans", (0, 0), 11, scans),
    "beams negative": changed("scans", (slice(2), 0), (-10, 30), scans),
    "scan round many times": changed("scans", (0, 2), 100.0, scans),
    "scan with bounds turned round": changed("scans", (0, 4), 0.01, scans),
    "ranges in a table": lambda: packed({**scans(), "ranges": np.zeros((8, 5), np.float32)}),
}


@pytest.mark.parametrize("kind", MALFORMED)
def test_a_malformed_map_ends_in_one_sentence(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "home.npz"
    path.write_bytes(MALFORMED[kind]())
    with pytest.raises(InputError) as caught:
        read_map(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    assert 20 < len(text.removeprefix(str(path))) < 200


def test_random_changes_of_bytes_end_in_one_sentence_or_change_nothing(tmp_path: Path) -> None:
    whole, path = packed(good()), tmp_path / "home.npz"
    rng = np.random.default_rng(0)
    refused: list[str] = []
    for _ in range(200):
        content = bytearray(whole)
        for at in rng.integers(0, len(content), rng.integers(1, 4)):
            content[at] = rng.integers(256)
        path.write_bytes(content)
        try:
            slam = read_map(path)
        except InputError as error:
            refused.append(str(error))
        else:
            np.testing.assert_array_equal(slam.graph.poses, good()["poses"])
    assert len(refused) > 100
    assert not any("\n" in text for text in refused)


@pytest.mark.parametrize("make", [good, scans])
def test_a_good_map_is_read_and_known_as_one(tmp_path: Path, make: Callable[[], Arrays]) -> None:
    path, again, other = tmp_path / "home.npz", tmp_path / "again.npz", tmp_path / "other.npz"
    path.write_bytes(packed(make()))
    slam = read_map(path)
    np.testing.assert_array_equal(slam.graph.poses, make()["poses"])
    with again.open("wb") as file:
        write_map(slam, file)
    assert is_map(again)
    np.savez(other, stamps=np.zeros(3))
    assert not is_map(other)
    assert not is_map(tmp_path / "none.npz")


def test_an_empty_map_is_one(tmp_path: Path) -> None:
    with (tmp_path / "empty.npz").open("wb") as file:
        write_map(Slam(), file)
    assert len(read_map(tmp_path / "empty.npz").keyframes) == 0
