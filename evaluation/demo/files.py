"""The files of a run, and what to do with each."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from estimation.errors import InputError

STORE = "world.sqlite"
TRACES = (
    "index.html",
    "logs",
)  # what a demo leaves, the first where it ended well, the second where it did not


def begin_in(folder: Path) -> Path:
    """Make the folder of a demo, without the memory of an earlier one; its path.

    Raises InputError where there is one that no demo seems to have made: it may be a robot's.
    """
    folder.mkdir(parents=True, exist_ok=True)
    store = folder / STORE
    if store.exists() and not any((folder / name).exists() for name in TRACES):
        raise InputError(f"{store}: would be replaced; choose another folder with --out, or remove it")
    for old in folder.glob(f"{STORE}*"):
        old.unlink()
    return store


def files_of(folder: Path, *bags: Path) -> list[tuple[Path, str]]:
    """Files for the page, each with a sentence; a Rerun recording is made where the package is installed.

    folder : of the page. bags : what was played, and what was recorded. Only what is in the folder is linked.
    """
    shown = " ".join(bag.name if bag.parent == folder else str(bag) for bag in bags)
    words = ("what the robot measured, with the truth where it is known", "what the nodes said")
    found = [
        (bag, f"{said} (opens in Foxglove)")
        for bag, said in zip(bags, words, strict=False)
        if bag.parent == folder
    ]
    found.append((folder / STORE, "the memory: `whereabouts ask world.sqlite where is the red cup`"))
    found.append((rerun_of(folder, bags), f"for Rerun: `rerun run.rrd`, or `whereabouts view {shown}`"))
    here = find_spec("rerun") is not None or not bags
    said = "of the nodes" + (
        "" if here else f". For a Rerun recording: `whereabouts view {shown} --save run.rrd`"
    )
    found.append((folder / "logs", said))
    return found


def rerun_of(folder: Path, bags: tuple[Path, ...]) -> Path:
    """A Rerun recording of the bags in `folder`, made where rerun-sdk is installed."""
    target = folder / "run.rrd"
    if find_spec("rerun") is None or not bags:
        return target
    from whereabouts.viewer.playback import play
    from whereabouts.viewer.rerun_sink import RerunSink

    with RerunSink(target) as sink:
        play([bag for bag in bags if bag.exists()], sink, None, "", [], lambda share: None)
    return target
