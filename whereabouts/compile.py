"""Compiles what the nodes run, once per machine and change of the sources: `python -m whereabouts.compile`.

A node that has to compile starts slowly and holds the compiler's memory as long as it runs; one that finds compiled
functions beside the sources does not. After an edit, only what depends on it is compiled.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import loop_closure.loop_closure_warm_up
import registration.registration_warm_up
import tracking.people.people_warm_up
import whereabouts.messages.compressed_depth
import world_model.tasks.maintenance
import world_model.warm_up
from registration.crf.online import ScanSegmenter
from tracking.intentions.intention_model import IntentionModel
from whereabouts.compiled_cache import forget_stale, keep_note


def _registration() -> None:
    registration.registration_warm_up.warm_up()
    registration.registration_warm_up.warm_up_segmenter(ScanSegmenter())


def _loop_closure() -> None:
    loop_closure.loop_closure_warm_up.warm_up()
    loop_closure.loop_closure_warm_up.warm_up_recognition()


def _motion_prediction() -> None:
    IntentionModel().warm_up()


def _world_model() -> None:
    world_model.warm_up.warm_up()
    world_model.tasks.maintenance.warm_up()
    whereabouts.messages.compressed_depth.warm_up()


# What takes longest first.
PARTS: dict[str, Callable[[], None]] = {
    "world model": _world_model,
    "registration": _registration,
    "people": tracking.people.people_warm_up.warm_up,
    "loop closure": _loop_closure,
    "motion prediction": _motion_prediction,
}


def _heed_interrupts() -> None:
    """End at Ctrl-C at once: llvmlite swallows the KeyboardInterrupt that comes inside the compiler."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def main() -> int:
    """Compile all parts, two at a time."""
    root = Path(__file__).resolve().parents[1]
    print(f"compiling what depends on {forget_stale(root)} new or edited files", flush=True)
    # Before it compiles: whatever is compiled when it is interrupted is kept, and what is edited meanwhile has changed.
    keep_note(root)
    with ProcessPoolExecutor(
        max_workers=2, mp_context=get_context("spawn"), initializer=_heed_interrupts
    ) as pool:
        running = {name: pool.submit(part) for name, part in PARTS.items()}
        for name, part in running.items():
            part.result()
            print(f"compiled: {name}", flush=True)
    return 0


if __name__ == "__main__":
    _heed_interrupts()
    sys.exit(main())
