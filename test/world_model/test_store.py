"""The store: restart, SIGKILL at any moment, torn write-ahead logs, damage, full disks, limits."""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from estimation.errors import InputError
from evaluation.store_damage import run
from world_model import WorldObject, WorldState, ask
from world_model.memory import store_file
from world_model.memory.store import Store, StoreError
from world_model.memory.store_file import StoreVersionError, is_store
from world_model.memory.store_format import OBJECTS, VERSION
from world_model.memory.store_repair import examine

ROOT = Path(__file__).resolve().parents[2]


def thing(number: int, step: int = 0, x: float = 0.0, **changes: object) -> WorldObject:
    made = WorldObject(
        f"cup-{number}",
        np.array([x, float(number), 0.8]),
        np.zeros(3),
        np.diag([0.01, 0.02, 0.03]),
        {"class": {"cup": 0.9, "bowl": 0.1}, "color": {"red": 1.0}},
        0.98,
        False,
        float(step),
        0.0,
        {"constant_position": 0.9, "uniform": 0.1},
    )
    return replace(made, **changes)


def state(step: int, *objects: WorldObject, epoch: int = 0) -> WorldState:
    return WorldState(objects, 1.0, float(len(objects)), float(step), epoch)


def marching(step: int) -> WorldState:
    """A world that differs at every step: one marches, one waits, one comes and goes."""
    objects = [thing(1, step, x=0.1 * step), thing(2, 0)]
    if step // 10 % 2:
        objects.append(thing(3 + step // 20, step))
    return state(step, *objects)


def same(a: WorldObject, b: WorldObject) -> bool:
    return (
        a.id == b.id
        and np.array_equal(a.position, b.position)
        and np.array_equal(a.velocity, b.velocity)
        and np.array_equal(a.covariance, b.covariance)
        and a.attributes == b.attributes
        and a.behaviors == b.behaviors
        and (a.existence, a.lost, a.last_seen, a.first_seen, a.region)
        == (b.existence, b.lost, b.last_seen, b.first_seen, b.region)
    )


def same_world(objects: tuple[WorldObject, ...], step: int) -> bool:
    expected = {item.id: item for item in marching(step).objects}
    return expected.keys() == {item.id for item in objects} and all(same(i, expected[i.id]) for i in objects)


def test_a_store_is_known_as_one_also_while_a_node_has_it_open(tmp_path: Path) -> None:
    path, killed, other = tmp_path / "world.sqlite", tmp_path / "killed.sqlite", tmp_path / "other.sqlite"
    with Store(path) as store:
        store.record(marching(0))
        assert is_store(path)
        for suffix in ("", "-wal"):
            shutil.copy(f"{path}{suffix}", f"{killed}{suffix}")
        assert is_store(killed)
    assert is_store(path)
    with sqlite3.connect(other) as connection:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("CREATE TABLE topics (name TEXT)")
        connection.commit()
        assert Path(f"{other}-wal").exists()
        assert not is_store(other)
    assert not is_store(tmp_path / "none")


def test_a_restart_finds_what_was_known_to_the_last_digit(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "world.sqlite"
    lost = thing(9, lost=True, region=((0.0, 1.0), (-2.0, 3.0), (0.0, 2.5)), process_noise=1e-4 * np.eye(3))
    with Store(path) as store:
        assert store.restore() is None
        for step in range(37):
            store.record(marching(step))
        store.record(state(37, *marching(37).objects, lost))
    with Store(path) as store:
        memory = store.restore()
        assert memory is not None
        assert (memory.stamp, memory.epoch) == (37.0, 0)
        assert memory.names == {"cup": 9}
        assert same(memory.objects[-1], lost)
        assert np.array_equal(memory.objects[-1].process_noise, lost.process_noise)
        assert same_world(memory.objects[:-1], 37)
        # An object that is gone keeps its symbol for itself.
        assert [entry.event for entry in store.history("cup-3")] == ["appeared", "gone"]


def test_history_has_every_event_and_no_row_for_waiting(tmp_path: Path) -> None:
    with Store(tmp_path / "world.sqlite") as store:
        store.record(state(0, thing(1)))
        for step in range(1, 50):
            store.record(state(step, thing(1, step)))
        store.record(state(50, thing(1, 50, x=2.0)))
        store.record(state(51, thing(1, 50, x=2.0, lost=True)))
        store.record(state(52, thing(1, 52, x=3.0)))
        store.record(state(53))
        store.record(state(54, thing(1, 54, x=3.0)))
        for step in range(55, 140):
            store.record(state(step, thing(1, step, x=3.0)))
        events = [(entry.stamp, entry.event) for entry in store.history("cup-1")]
        assert events == [
            (0.0, "appeared"),
            (50.0, "moved"),
            (51.0, "lost"),
            (52.0, "found"),
            (53.0, "gone"),
            (54.0, "returned"),
            (114.0, "seen"),
        ]
        assert store.objects_at(25.0)[0].position[0] == 0.0
        assert store.objects_at(50.5)[0].position[0] == 2.0
        assert store.objects_at(53.5) == []
        assert store.objects_at(-1.0) == []


def test_a_thing_that_late_evidence_puts_elsewhere_is_there_after_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    with Store(path) as store:
        store.record(state(0, thing(1)))
        store.record(state(1, thing(1, x=0.7)))
    with Store(path) as store:
        memory = store.restore()
        assert memory is not None
        assert memory.objects[0].position[0] == 0.7


def test_uncertainty_of_the_past_grows_between_rows(tmp_path: Path) -> None:
    with Store(tmp_path / "world.sqlite") as store:
        store.record(state(0, thing(1, process_noise=0.01 * np.eye(3))))
        assert store.objects_at(4.0)[0].covariance == pytest.approx(np.diag([0.05, 0.06, 0.07]))


def test_a_new_run_empties_the_world_and_keeps_the_history(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    with Store(path) as store:
        store.record(state(100, thing(1), thing(2)))
        store.record(state(10, thing(1, 10, x=5.0), epoch=1))
        assert [item.position[0] for item in store.objects_at(120.0, epoch=0)] == [0.0, 0.0]
        assert [item.position[0] for item in store.objects_at(120.0)] == [5.0]
        store.begin(2)
    with Store(path) as store:
        memory = store.restore()
        assert memory is not None
        assert (memory.objects, memory.epoch) == ((), 2)
        assert [run for run, *_ in store.epochs()] == [0, 1, 2]
        assert store.history("cup-2")[0].epoch == 0


def test_what_cannot_be_looked_up_is_said_in_the_store_s_own_words(tmp_path: Path) -> None:
    store = Store(tmp_path / "world.sqlite")
    store.record(marching(1))
    for stamp in (np.nan, "now", None):
        with pytest.raises(InputError, match="stamp"):
            store.objects_at(stamp)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="object_id"):
        store.history(3)  # type: ignore[arg-type]
    store.close()
    with pytest.raises(StoreError, match=r"world\.sqlite"):
        store.objects_at(1.0)


def test_renaming_takes_the_history_along(tmp_path: Path) -> None:
    with Store(tmp_path / "world.sqlite") as store:
        store.record(state(0, thing(1)))
        store.rename("cup-1", "favourite")
        store.record(state(1, thing(1, 1, id="favourite")))
        assert [entry.object.id for entry in store.history("favourite")] == ["favourite"]
        assert store.history("cup-1") == []


CHILD = """
import sys
sys.path[:0] = [{root!r}, {here!r}]
from test_store import Store, marching
store = Store({path!r})
memory = store.restore()
step = 0 if memory is None else int(memory.stamp) + 1
while True:
    store.record(marching(step))
    print(step, flush=True)
    step += 1
"""


def test_sigkill_at_any_moment_loses_at_most_the_message_being_written(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    code = CHILD.format(root=str(ROOT), here=str(Path(__file__).parent), path=str(path))
    rng = np.random.default_rng(3)
    reported = -1
    for _ in range(6):
        child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
        assert child.stdout is not None
        for _ in range(int(rng.integers(1, 400))):
            reported = int(child.stdout.readline())
        child.send_signal(signal.SIGKILL)
        # What was still in the pipe was recorded too.
        reported = max([reported, *(int(line) for line in child.stdout.read().split("\n")[:-1])])
        child.wait()
        child.stdout.close()
        with Store(path) as store:
            memory = store.restore()
            assert memory is not None
            assert store.set_aside is None
            step = int(memory.stamp)
            assert reported <= step <= reported + 1
            assert same_world(memory.objects, step)
            reported = step
    with Store(path) as store:
        marched = [entry.object.position[0] for entry in store.history("cup-1")]
        assert marched == pytest.approx([0.1 * k for k in range(len(marched))])


def test_a_torn_write_ahead_log_takes_back_whole_messages_only(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    store = Store(path)
    for step in range(60):
        store.record(marching(step))
    copy, wal = tmp_path / "copy.sqlite", Path(f"{path}-wal").read_bytes()
    rng = np.random.default_rng(5)
    steps = []
    for size in sorted([0, *rng.integers(1, len(wal), 24), len(wal)]):
        shutil.copy(path, copy)
        Path(f"{copy}-wal").write_bytes(wal[: int(size)])
        Path(f"{copy}-shm").unlink(missing_ok=True)
        with Store(copy) as torn:
            memory = torn.restore()
            steps.append(-1 if memory is None else int(memory.stamp))
            assert torn.set_aside is None
            assert memory is None or same_world(memory.objects, steps[-1])
        for suffix in ("", "-wal", "-shm"):
            Path(f"{copy}{suffix}").unlink(missing_ok=True)
    store.close()
    assert steps == sorted(steps)
    assert steps[-1] == 59
    assert len(set(steps)) > 10


@pytest.mark.parametrize("damage", ["garbage", "middle", "empty page", "row", "empty"])
def test_a_damaged_file_is_set_aside_and_what_is_whole_goes_on(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "world.sqlite"
    with Store(path) as store:
        for step in range(300):
            store.record(marching(step))
        before = store.history("cup-1")
    content = bytearray(path.read_bytes())
    if damage == "garbage":
        content[:] = b"this is not a database " * 200
    elif damage == "middle":
        content[4096 * 8 : 4096 * 10] = os.urandom(4096 * 2)
    elif damage == "empty page":
        content[4096 * 8 : 4096 * 9] = bytes(4096)
    elif damage == "empty":
        content.clear()
    else:
        at = content.rindex(b'{"class"')
        content[at] = ord("[")
    path.write_bytes(content)
    with Store(path) as store:
        assert store.set_aside == tmp_path / "world.sqlite.damaged-1"
        assert "is damaged" in store.problem
        assert store.damages == [store.problem]
        kept = store.history("cup-1")
        assert all(any(same(a.object, b.object) and a.stamp == b.stamp for b in before) for a in kept)
        assert len(kept) >= {"garbage": 0, "empty": 0, "row": len(before) - 1}.get(damage, len(before) - 20)
        store.record(marching(300))
        assert len(store.history("cup-1")) == len(kept) + 1
    assert (tmp_path / "world.sqlite.damaged-1").read_bytes() == bytes(content)
    assert "is damaged" in (tmp_path / "world.sqlite.damaged-1.txt").read_text()
    with Store(path) as store:
        assert store.damages == []
        memory = store.restore()
        assert memory is not None
        assert same_world(memory.objects, 300)


def test_no_single_damage_changes_a_fact_without_a_word() -> None:
    tally = run(240, seed=3)
    assert (tally.damages, tally.silent, tally.untrue, tally.refused) == (240, 0, 0, 0), tally.examples
    assert 80 < tally.reported < 240
    assert min(tally.kept) >= 0.99, tally.examples


def test_a_row_of_other_kinds_of_values_is_not_whole() -> None:
    row = (7, 0, "cup-1")
    assert OBJECTS.is_whole((*row, OBJECTS.mark(row)))
    for other in ((7, 0, 5, 0), (7, "0", "cup-1", 0), (7, 0, None, None), (7, 0), (7, 1 << 70, "cup-1", 0)):
        assert not OBJECTS.is_whole(other)


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE history SET numbers = CAST(numbers AS TEXT) WHERE row = 3",
        "UPDATE history SET attributes = CAST(attributes AS BLOB) WHERE row = 3",
        "UPDATE current SET behaviors = CAST(behaviors AS BLOB)",
        "UPDATE clock SET identity = CAST(identity AS BLOB)",
    ],
)
def test_text_that_became_bytes_or_the_other_way_round_is_damage(tmp_path: Path, change: str) -> None:
    path = tmp_path / "world.sqlite"
    with Store(path) as store:
        for step in range(20):
            store.record(marching(step))
        rows = store.rows
    with sqlite3.connect(path) as connection:
        assert connection.execute(change).rowcount > 0
    connection.close()
    with Store(path) as store:
        assert store.damages
        assert "nothing lost" in store.damages[0]
        assert store.rows == rows
        memory = store.restore()
        assert memory is not None
        assert same_world(memory.objects, 19)


@pytest.mark.parametrize("table", ["current", "history", "objects"])
def test_a_row_whose_text_is_none_is_the_only_one_lost(tmp_path: Path, table: str) -> None:
    path = tmp_path / "world.sqlite"
    with Store(path) as store:
        for step in range(100):
            store.record(marching(step))
        rows = store.rows
    column, key = ("id", "key") if table == "objects" else ("attributes", "rowid")
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(f"UPDATE {table} SET {column} = CAST(x'ff41' AS TEXT) WHERE {key} = 1")
    with Store(path) as store:
        assert f"row 1 of {table} is damaged" in store.damages[0]
        assert store.rows == rows - (table == "history")
        memory = store.restore()
        assert memory is not None
        assert {item.id for item in memory.objects} == {item.id for item in marching(99).objects}


def test_a_table_described_otherwise_is_put_right(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    with Store(path) as store:
        store.record(marching(0))
    path.write_bytes(path.read_bytes().replace(b"epochs (epoch INTEGER", b"epochs (apoch INTEGER", 1))
    with Store(path) as store:
        assert "what the file says of its tables" in store.damages[0]
        memory = store.restore()
        assert memory is not None
        assert same_world(memory.objects, 0)


def test_a_restart_without_the_head_of_the_log_loses_nothing(tmp_path: Path) -> None:
    path, copy = tmp_path / "world.sqlite", tmp_path / "copy.sqlite"
    with Store(path) as store:
        for step in range(60):
            store.record(marching(step))
        shutil.copy(path, copy)
        log = bytearray(Path(f"{path}-wal").read_bytes())
    log[17] ^= 4
    Path(f"{copy}-wal").write_bytes(log)
    with Store(copy) as store:
        assert "the head of the write-ahead log is damaged" in store.damages[0]
        memory = store.restore()
        assert memory is not None
        assert same_world(memory.objects, 59)


def test_messages_that_a_log_lost_whole_are_missed(tmp_path: Path) -> None:
    path, copy = tmp_path / "world.sqlite", tmp_path / "copy.sqlite"
    with Store(path) as store:
        for step in range(60):
            store.record(marching(step))
            if step == 49:
                for suffix in ("", "-wal"):
                    shutil.copy(f"{path}{suffix}", f"{copy}{suffix}")
        shutil.copy(f"{path}.lock", f"{copy}.lock")
    with Store(copy) as store:
        assert store.damages == [f"{copy}: the last 10 messages are missing in it"]
    with Store(copy) as store:
        assert store.damages == []


def test_what_is_lost_comes_back_from_a_snapshot_of_the_same_store(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    with Store(path) as store:
        for step in range(100):
            store.record(marching(step))
        store.watch(3600.0)
        assert store.keeper is not None
        store.keeper.look()
        store.keeper.look()
        assert (store.keeper.checks, store.keeper.snapshots) == (2, 1)
        store.record(marching(100))
        store.keeper.look()
        before = store.history("cup-1")
    snapshots = [tmp_path / f"world.sqlite.snapshot-{number}" for number in (1, 2)]
    with Store(snapshots[0], read_only=True) as newer, Store(snapshots[1], read_only=True) as older:
        assert (newer.restore().stamp, older.restore().stamp) == (100.0, 99.0)  # type: ignore[union-attr]
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 4])
    with Store(path) as store:
        assert "from snapshots" in store.problem
        assert len(store.history("cup-1")) == len(before)
    with Store(tmp_path / "other.sqlite") as other:
        other.record(marching(0))
    for number, snapshot in enumerate(snapshots):
        snapshot.replace(tmp_path / f"other.sqlite.snapshot-{number + 1}")
    content = bytearray((tmp_path / "other.sqlite").read_bytes())
    content[content.index(b"appeared")] ^= 1
    (tmp_path / "other.sqlite").write_bytes(content)
    with Store(tmp_path / "other.sqlite") as other:
        assert "from snapshots" not in other.problem
        assert len(other.history("cup-1")) <= 1


@pytest.mark.parametrize("read_only", [False, True])
def test_what_was_found_whole_is_not_looked_through_again_until_a_bit_of_it_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, read_only: bool
) -> None:
    path = tmp_path / "world.sqlite"
    looks = []

    def counted(connection: sqlite3.Connection, *more: object) -> list[str]:
        looks.append(path)
        return examine(connection, *more)  # type: ignore[arg-type]

    monkeypatch.setattr(store_file, "examine", counted)
    with Store(path) as store:
        for step in range(100):
            store.record(marching(step))
    assert len(looks) == 2  # when it was made, and when it was closed
    assert sorted(each.name for each in tmp_path.iterdir()) == ["world.sqlite", "world.sqlite.lock"]
    for _ in range(2):
        with Store(path, read_only=read_only) as store:
            assert store.rows > 100
    assert len(looks) == 2
    whole, beside = path.read_bytes(), Path(f"{path}.lock").read_bytes()
    for at in np.random.default_rng(5).choice(len(whole), 20, replace=False).tolist():
        damaged = bytearray(whole)
        damaged[at] ^= 4
        path.write_bytes(damaged)
        before = len(looks)
        with Store(path, read_only=True) as store:
            assert len(looks) > before or store.damages, at
        path.write_bytes(whole)
        Path(f"{path}.lock").write_bytes(beside)
    # What is beside it is no proof for another file, nor once it is damaged itself.
    Path(f"{path}.lock").write_bytes(beside[:-1] + bytes([beside[-1] ^ 1]))
    before = len(looks)
    with Store(path, read_only=read_only) as store:
        assert not store.damages
    assert len(looks) == before + 1


def test_a_copy_without_what_lies_beside_the_store_is_looked_through_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, copy = tmp_path / "world.sqlite", tmp_path / "copy.sqlite"
    with Store(path) as store:
        for step in range(20):
            store.record(marching(step))
        written = store.restore()
    shutil.copy(path, copy)
    looks = []

    def counted(connection: sqlite3.Connection) -> list[str]:
        looks.append(copy)
        return examine(connection)

    monkeypatch.setattr(store_file, "examine", counted)
    for _ in range(3):
        with Store(copy, read_only=True) as store:
            found = store.restore()
            assert found is not None
            assert written is not None
            assert [item.id for item in found.objects] == [item.id for item in written.objects]
            assert found.names == written.names
    assert len(looks) == 1


def test_a_writer_that_was_killed_leaves_nothing_that_is_taken_for_whole(tmp_path: Path) -> None:
    path, copy = tmp_path / "world.sqlite", tmp_path / "copy.sqlite"
    with Store(path) as store:
        for step in range(50):
            store.record(marching(step))
    with Store(path) as store:
        store.record(marching(50))
        for suffix in ("", "-wal", ".lock"):
            shutil.copy(f"{path}{suffix}", f"{copy}{suffix}")
    log = bytearray(Path(f"{copy}-wal").read_bytes())
    log[-100] ^= 1
    Path(f"{copy}-wal").write_bytes(log)
    with Store(copy, read_only=True) as store:
        assert store.damages


def test_what_is_read_of_a_damaged_store_says_so_and_nothing_is_no_empty_world(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    with Store(path) as store:
        for step in range(20):
            store.record(marching(step))
    whole = path.read_bytes()
    path.write_bytes(bytes(100) + whole[100:])
    answer = ask(path, "where is cup-1")
    assert answer.value is not None
    assert f"{path}: is damaged" in answer.sentence
    for left in (whole[:5000], bytes(len(whole)), b""):
        path.write_bytes(left)
        with pytest.raises(StoreError, match=r"world.sqlite: is no .* nothing in it is whole.*put a copy"):
            ask(path, "where is cup-1")
        assert path.read_bytes() == left


def test_damage_found_in_the_background_is_put_right_with_the_next_message(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    with Store(path) as store:
        for step in range(100):
            store.record(marching(step))
        store.save()
        content = path.read_bytes()
        at = content.rindex(b'{"class"')
        with path.open("r+b") as file:
            file.seek(at)
            file.write(b"[")
        store._execute("PRAGMA shrink_memory")
        store.watch(3600.0)
        assert store.keeper is not None
        store.keeper.look()
        assert "is damaged" in store.keeper.found[0]
        store.record(marching(100))
        assert len(store.damages) == 1
        assert store.keeper is not None
        assert store.keeper.found == []
        memory = store.restore()
        assert memory is not None
        assert same_world(memory.objects, 100)


def test_a_store_of_the_first_version_is_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    shutil.copy(Path(__file__).parent / "store_version_1.sqlite", path)
    with Store(path, read_only=True) as store:
        assert (store.damages, len(store.history("cup-1"))) == ([], 100)
    with Store(path) as store:
        assert (store.damages, store.problem) == ([], "")
        assert [entry.stamp for entry in store.history("cup-1")] == [float(k) for k in range(100)]
        memory = store.restore()
        assert memory is not None
        assert same_world(memory.objects, 99)
        assert [run for run, *_ in store.epochs()] == [0]
        store.record(marching(100))
    with Store(path) as store:
        assert store.damages == []
        assert len(store.history("cup-1")) == 101


def test_damage_while_running_loses_nothing_of_the_present(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    with Store(path) as store:
        for step in range(200):
            store.record(marching(step))
        store.save()
        with path.open("r+b") as file:
            file.seek(4096)
            file.write(os.urandom(path.stat().st_size - 4096))
        # SQLite notices once it needs a page that it no longer has at hand.
        store._execute("PRAGMA shrink_memory")
        for step in range(200, 260):
            store.record(marching(step))
            if store.set_aside is not None:
                break
        assert store.set_aside is not None
        assert "is damaged" in store.damages[0]
        store.record(marching(261))
        assert store.problem == ""
    with Store(path) as store:
        memory = store.restore()
        assert memory is not None
        assert same_world(memory.objects, 261)


def test_other_versions_and_other_databases_are_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    Store(path).close()
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA user_version = 7")
    connection.close()
    before = path.read_bytes()
    with pytest.raises(
        StoreVersionError, match=rf"world.sqlite: is of version 7, this program reads version {VERSION}"
    ):
        Store(path)
    assert path.read_bytes() == before
    other = tmp_path / "other.sqlite"
    connection = sqlite3.connect(other)
    connection.execute("CREATE TABLE letters (text)")
    connection.close()
    with pytest.raises(StoreVersionError, match="not a world model's"):
        Store(other)
    with Store(tmp_path / "mine.sqlite") as store, pytest.raises(StoreError, match="not a world model's"):
        store.save(other)


def test_a_full_disk_stops_neither_the_model_nor_what_was_stored(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    with Store(path) as store:
        for step in range(20):
            store.record(marching(step))
        pages = store._execute("PRAGMA page_count").fetchone()[0]
        store._execute(f"PRAGMA max_page_count = {pages}")
        many = [thing(number, 20) for number in range(1, 400)]
        for step in range(20, 25):
            store.record(state(step, *many))
        assert "world.sqlite: not written: database or disk is full" in store.problem
        assert store.failures >= 1
        memory = Store(path, read_only=True).restore()
        assert memory is not None
        assert same_world(memory.objects, 19)
        store._execute("PRAGMA max_page_count = 100000")
        store.record(state(24, *many))
        assert store.problem == "", "what waits for room is written at once when there is room"
        store.record(state(30, *many))
    with Store(path) as store:
        memory = store.restore()
        assert memory is not None
        assert (memory.stamp, len(memory.objects)) == (30.0, 399)


def test_what_a_disk_did_not_take_is_written_when_it_does_though_stamps_stand_still(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, now = tmp_path / "world.sqlite", [100.0]
    monkeypatch.setattr("world_model.memory.store.time.monotonic", lambda: now[0])
    with Store(path) as store:
        store.record(state(0, thing(1)))
        written = store._record
        tried = []

        def broken(world: WorldState) -> None:
            tried.append(world.stamp)
            raise sqlite3.OperationalError("disk I/O error")

        monkeypatch.setattr(store, "_record", broken)
        for step in range(1, 10):
            store.record(state(step, thing(1, step, x=0.7)))
        assert len(tried) == 3, "after some failures it is not tried with every message"
        monkeypatch.setattr(store, "_record", written)
        store.retry()
        assert "disk I/O error" in store.problem
        now[0] += 1.1
        store.retry()
        assert store.problem == ""
    with Store(path) as store:
        memory = store.restore()
        assert memory is not None
        assert (memory.objects[0].position[0], memory.stamp) == (0.7, 9.0)


def test_only_one_process_writes_and_any_may_read(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    with Store(path) as store:
        store.record(marching(0))
        with pytest.raises(StoreError, match="another process writes"):
            Store(path)
        with Store(path, read_only=True) as reader:
            store.record(marching(1))
            assert len(reader.history("cup-1")) == 2
    with pytest.raises(StoreError, match="no such store"):
        Store(tmp_path / "nowhere.sqlite", read_only=True)
    with pytest.raises(StoreError, match="cannot be opened"):
        Store(Path("/proc/nowhere/world.sqlite"))


def test_a_file_that_somebody_removed_is_written_again(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    with Store(path) as store:
        store.record(marching(0))
        for suffix in ("", "-wal", "-shm"):
            Path(f"{path}{suffix}").unlink()
        store.record(marching(1))
    with Store(path) as store:
        memory = store.restore()
        assert memory is not None
        assert same_world(memory.objects, 1)


def test_history_stays_within_its_limit_and_is_thinned_where_it_is_old(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    sizes = []
    with Store(path, limit=400) as store:
        for step in range(6000):
            store.record(state(step, thing(1, step, x=0.3 * step), thing(2)))
            if step in (2000, 5999):
                sizes.append(path.stat().st_size)
        entries = store.history("cup-1")
        assert store.rows <= 400
        assert sizes[1] <= 1.2 * sizes[0]
        stamps = np.array([entry.stamp for entry in entries])
        assert entries[0].event == "appeared"
        assert (np.diff(stamps[-150:]) == 1.0).all()
        assert np.diff(stamps).max() > 4.0
        assert [entry.event for entry in store.history("cup-2")] == ["appeared"]
        assert store.compact(limit=100) >= 250
        assert store.history("cup-1")[0].event == "appeared"
        assert path.stat().st_size < sizes[0]


def test_a_copy_is_a_complete_store_whatever_lay_beside_it(tmp_path: Path) -> None:
    copy, killed = tmp_path / "copy.sqlite", tmp_path / "killed.sqlite"
    with Store(killed) as other:
        other.record(state(0, thing(7)))
        for suffix in ("-wal", "-shm"):
            shutil.copy(f"{killed}{suffix}", f"{copy}{suffix}")
    with Store(tmp_path / "world.sqlite") as store:
        for last in (5, 9):
            for step in range(last):
                store.record(marching(step))
            assert store.save(copy) == copy
        assert store.save() == store.path
    with Store(copy) as other:
        memory = other.restore()
        assert memory is not None
        assert same_world(memory.objects, 8)
        with (
            Store(tmp_path / "world.sqlite") as store,
            pytest.raises(StoreError, match="another process writes"),
        ):
            store.save(copy)


def test_a_copy_that_cannot_be_read_back_is_no_success(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = tmp_path / "copy.sqlite"
    with Store(tmp_path / "world.sqlite") as store:
        store.record(marching(0))
        store.save(copy)
        before = copy.read_bytes()
        store.record(marching(1))
        monkeypatch.setattr(
            "world_model.memory.store_file.examine", lambda connection, *_: ["page 3 is damaged"]
        )
        with pytest.raises(StoreError, match="reading it back shows: page 3 is damaged"):
            store.save(copy)
    assert copy.read_bytes() == before


def test_what_is_no_store_is_never_overwritten(tmp_path: Path) -> None:
    foreign = tmp_path / "authorized_keys"
    foreign.write_text("ssh-ed25519 AAAA")
    with Store(tmp_path / "world.sqlite") as store, pytest.raises(StoreError, match="not overwritten"):
        store.save(foreign)
    assert foreign.read_text() == "ssh-ed25519 AAAA"
