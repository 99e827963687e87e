"""Whether a replay of the demo repeats: `python -m evaluation.repeats [--seconds 20] [--busy 2]`.

The first seconds of the apartment's day (0: all of it) go through all eight nodes in lock-step twice, the second time
beside busy processes, with the demo's requests to verify and to search. Every recorded message is unpacked and compared
field by field, topic by topic, with the moment of the bag at which it came; what several nodes say on one topic at the
same moment has no order. Of diagnostics, which nodes send by the wall clock, the last of each node counts, without the
figures named in `BY_WALL_CLOCK`.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message

from evaluation.demo.demo_suite import RECORDED
from evaluation.demo.replay import DemoScript, full_script, replay
from whereabouts.logs import open_raw
from whereabouts.nodes.messages.message_types import message_class
from whereabouts.nodes.runtime.suite_run import prepare_environment
from whereabouts.simulation.home.apartment_bag import START, record

# What diagnostics tell of the machine and not of the robot: a figure whose name holds one of these. How far an input is
# behind depends on which of two topics, sent by two nodes for the same moment, came first.
BY_WALL_CLOCK = (
    "rate [Hz]", "behind [s]", "latency", "[ms]", " ms", "slowest", "checks of the store", "snapshots", "/turn ",
)  # fmt: skip
# s of the bag at which the thing is verified and searched in an excerpt, which it has in view then.
EXCERPT = DemoScript("cup", START + 10.5, START + 11.0)
TOLD = 10
# A message as (field, value) pairs, and so on down to numbers, texts and the bytes of arrays.
Plain = Any
Said = dict[str, list[tuple[int, list[Plain]]]]


def said(recording: Path) -> Said:
    """What was recorded: for each topic the moments, ns, with all messages of that moment."""
    moments: dict[str, dict[int, list[Plain]]] = defaultdict(lambda: defaultdict(list))
    last: dict[str, Plain] = {}
    names = {f"/{name}": name for name, _ in RECORDED}
    kinds = {f"/{name}": message_class(kind) for name, kind in RECORDED}
    with open_raw(recording, list(names.values())) as log:
        for message in log:
            content = deserialize_message(bytes(message.data), kinds[message.name])
            if message.name.endswith("diagnostics"):
                last |= {status.name: _status(status) for status in content.status}
            else:
                moments[message.name][message.log_time].append(_plain(content))
    found = {
        name: [(at, sorted(here, key=repr) if len(here) > 1 else here) for at, here in told.items()]
        for name, told in moments.items()
    }
    return found | {"/diagnostics": [(0, sorted(last.items()))]}


def _plain(value: Any) -> Plain:
    """All fields of a message, to the last digit."""
    if hasattr(value, "get_fields_and_field_types"):
        return tuple(
            (name, _plain(getattr(value, name))) for name in type(value).get_fields_and_field_types()
        )
    if isinstance(value, list):
        return tuple((str(number), _plain(item)) for number, item in enumerate(value))
    if hasattr(value, "tobytes"):
        return value.tobytes()
    # No number is like itself that is none.
    return repr(value) if isinstance(value, float) else value


def _status(status: Any) -> Plain:
    return tuple(
        (item.key, item.value)
        for item in status.values
        if not any(word in item.key for word in BY_WALL_CLOCK)
    )


def differences(one: Said, other: Said) -> list[str]:
    """Where two recordings differ, as sentences."""
    found = []
    for topic in sorted(one.keys() | other.keys()):
        mine, theirs = one.get(topic, []), other.get(topic, [])
        if len(mine) != len(theirs):
            found.append(f"{topic}: {len(mine)} moments and {len(theirs)}")
        for (at, here), (when, there) in zip(mine, theirs, strict=False):
            if (at, here) != (when, there):
                moments = f"{at / 1e9 - START:.3f} s, {when / 1e9 - START:.3f} s"
                found.append(f"{topic} at {moments}: {_first(here, there) or 'another number of messages'}")
                break
    return found


def _first(one: Plain, other: Plain) -> str:
    """The first field that differs, and both its values; empty where none does."""
    if not isinstance(one, list | tuple) or not isinstance(other, list | tuple):
        return "" if one == other else f": {one!r:.100} and {other!r:.100}"
    for number, (mine, theirs) in enumerate(zip(one, other, strict=False)):
        if mine != theirs:
            named = isinstance(mine, tuple) and len(mine) == 2 and isinstance(mine[0], str)
            if named and mine[0] == theirs[0]:
                return f".{mine[0]}{_first(mine[1], theirs[1])}"
            return f"[{number}]{_first(mine, theirs)}"
    return "" if len(one) == len(other) else f": {len(one)} items and {len(other)}"


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Beside so many processes that take all the time they get."""
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def compare(folder: Path, seconds: float, beside: int) -> tuple[list[str], int]:
    """Differences between a replay and one beside busy processes; how many messages were compared."""
    bag = folder / "excerpt.mcap"
    record(bag, seconds or None)
    script = EXCERPT if seconds else full_script()
    found = []
    for name, count in (("alone", 0), ("busy", beside)):
        with busy(count):
            recording, run = replay(bag, folder / name, script=script)
        if run.account.total_lost or run.account.unanswered:
            return [f"{name}: {run.account.total_lost} lost, {run.account.unanswered} unanswered"], 0
        found.append(said(recording))
    count = sum(len(here) for told in found[0].values() for _, here in told)
    return differences(*found), count


def main() -> int:
    """Entry point; exit status 1 where anything differs."""
    parser = argparse.ArgumentParser(prog="repeats", description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seconds", type=float, default=20.0, help="of the bag; 0: all of it")
    parser.add_argument("--busy", type=int, default=2, help="processes beside the second replay")
    parser.add_argument("--keep", type=Path, help="folder for bag, recordings and logs")
    given = parser.parse_args()
    prepare_environment(private=True)
    with tempfile.TemporaryDirectory() as aside:
        folder = given.keep or Path(aside)
        folder.mkdir(parents=True, exist_ok=True)
        found, count = compare(folder, given.seconds, given.busy)
    for text in found[:TOLD]:
        print(text)
    print(f"{count} messages compared, {len(found)} topics differ")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
