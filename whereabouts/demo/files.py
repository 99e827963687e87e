"""The files of a run, and what to do with each."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path


def files_of(folder: Path, *bags: Path) -> list[tuple[Path, str]]:
    """Files for the page, each with a sentence; a Rerun recording is made where the package is installed.

    folder : of the page. bags : what was played and what was recorded. Those outside the folder are named in the words.
    """
    inside = [bag for bag in bags if bag.parent == folder]
    shown = " ".join(str(bag) for bag in bags)
    found = [
        (bag, "what went over DDS, with its truth where it is known (opens in Foxglove)") for bag in inside
    ]
    store = folder / "world.sqlite"
    found.append((store, f"the memory: `whereabouts ask {store} where is the red cup`"))
    found.append((rerun_of(folder, bags), f"for Rerun; live: `whereabouts view {shown}`"))
    if find_spec("rerun") is None:
        found.append(
            (
                folder / "logs",
                f"of the nodes. For a Rerun recording: `whereabouts view {shown} --save run.rrd`",
            )
        )
    else:
        found.append((folder / "logs", "of the nodes"))
    return found


def rerun_of(folder: Path, bags: tuple[Path, ...]) -> Path:
    """A Rerun recording of the bags in `folder`, made where rerun-sdk is installed."""
    target = folder / "run.rrd"
    if find_spec("rerun") is None:
        return target
    from whereabouts.viewer.playback import play
    from whereabouts.viewer.rerun_sink import RerunSink

    with RerunSink(target) as sink:
        play([bag for bag in bags if bag.exists()], sink, None, "", [], lambda share: None)
    return target
