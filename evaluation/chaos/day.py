"""A simulated day of the real world model: looks, moves, kills and faults of disk, network and clocks, hour by hour.

The stamps run through 24 hours, compressed; where there is more time, through further days. Every hour a thing is new,
some are moved. Of what was known when the world model was killed nothing may be lost, and nothing of all this is a
reason for a new run. In the afternoon it is not killed, so that its memory tells whether it grows.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from scipy.stats import theilslopes

from evaluation.chaos.faults import PATIENCE, Faults, Laboratory, Spot, floor
from evaluation.chaos.generator import START
from evaluation.chaos.network import Link
from evaluation.chaos.times import FAR
from whereabouts.node_names import NODES
from whereabouts.nodes.messages.stamps import NANOSECONDS
from whereabouts.nodes.ros.executor import leave
from whereabouts.nodes.runtime.supervisor import NodeSpec, SuiteError
from whereabouts_msgs.msg import WorldEvidence

HOURS, MORNING, HOUR = 24, 12, 3600 * NANOSECONDS
LOOKS = 5  # at a thing, between two looks at what the world model says
# m by which a thing is moved; every how many hours one is, the disk is full, the network loses.
STEP, MOVES, DISKS, LOSSES = 0.7, 3, 3, 2
FULL = 0.5  # s of a full disk before and after something is moved, and between looks afterwards
RETRIES = 4
DRAINED = 0.1
SPOTS = 400
LEAST_SAMPLES = 6  # hours of one life


@contextmanager
def _quiet() -> Iterator[None]:
    """The middleware says of each broken message that it is one."""
    kept, nothing = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nothing)


def days(seconds: float, seed: int, folder: Path) -> Faults:
    """One day, and further ones until the time is over."""
    with _quiet():
        laboratory = Laboratory(seed, folder)
        try:
            _live(laboratory, seconds, seed)
        finally:
            leave(laboratory.node)
    return laboratory.found


def _live(laboratory: Laboratory, seconds: float, seed: int) -> None:
    found, supervisor = laboratory.found, laboratory.supervisor
    with supervisor:
        supervisor.start(laboratory.world)
        day = ChaosDay(laboratory, seed)
        begun, hours = time.monotonic(), 0
        try:
            while hours < HOURS or time.monotonic() - begun < seconds:
                # Of the hours that there is no time for, only the last of the morning has a kill.
                behind = time.monotonic() - begun > seconds * hours / HOURS
                if not day.live_through(hours, gently=behind and hours < HOURS and hours != MORNING - 1):
                    break
                hours += 1
        except SuiteError as error:
            found.deaths += 1
            print(error)
        found.hours = hours
        day.end_life()
        found.deaths += sum(len(node.deaths) for node in supervisor.nodes.values()) - found.kills


class ChaosDay:
    """What happens hour by hour."""

    def __init__(self, laboratory: Laboratory, seed: int) -> None:
        self._laboratory = laboratory
        self._rng = np.random.default_rng(seed)
        self._others = [name for name in NODES if name != laboratory.world.executable]
        self._seed = seed
        self._memory: list[tuple[int, float]] = []

    def live_through(self, hour: int, gently: bool) -> bool:
        """One hour; whether it goes on. gently : nobody is killed."""
        laboratory = self._laboratory
        laboratory.now = START + hour * HOUR
        link: Link[WorldEvidence] | None = Link(self._rng) if hour % LOSSES else None
        spot = floor(hour % SPOTS)
        if not self._bring(spot, link=link):
            return False
        wrong = float(self._rng.choice(FAR)) * (1.0 if hour % 2 else -0.1)
        laboratory.look(spot, off=wrong)
        if hour % MOVES == MOVES - 1 and not self._move(hour, disk=hour % (2 * DISKS) == DISKS - 1):
            return False
        self._memory.append((hour, laboratory.memory))
        return gently or self._strike(hour)

    def _bring(self, spot: Spot, name: str = "", link: Link[WorldEvidence] | None = None) -> bool:
        """Look at a thing until the world model says that it is there."""
        end = time.monotonic() + PATIENCE
        while not self._laboratory.at(spot):
            for _ in range(LOOKS):
                self._laboratory.look(spot, name, link=link)
            if time.monotonic() > end:
                self._laboratory.stall(f"nothing is known at {spot}")
                return False
        return True

    def _move(self, hour: int, disk: bool) -> bool:
        """Something stands elsewhere; while the disk is full, if there is to be one."""
        laboratory = self._laboratory
        before = floor(int(self._rng.integers(min(hour, SPOTS))))
        name, after = laboratory.at(before), (before[0], before[1] + STEP)
        if not name:
            return True
        if disk:
            laboratory.limit_disk(True)
            laboratory.spin(FULL)
        moved = self._bring(after, name)
        if disk:
            laboratory.spin(FULL)
            laboratory.limit_disk(False)
            # What was seen meanwhile is written with what is seen next; after some failures once a second.
            for _ in range(RETRIES):
                laboratory.look(after, name)
                laboratory.spin(FULL)
        return moved

    def _strike(self, hour: int) -> bool:
        """Broken messages for the world model and another node; then both are killed, in the afternoon the other."""
        laboratory = self._laboratory
        # What it makes of nonsense is nothing that the world model should hear.
        spec = NodeSpec(self._others[(self._seed + hour) % len(self._others)], namespace="/shaken")
        if spec.full_name not in laboratory.supervisor.nodes:
            laboratory.supervisor.start(spec)
        for shaken in (spec, laboratory.world):
            laboratory.shake(shaken)
        laboratory.kill(spec)
        if hour % HOURS >= MORNING:
            return True
        return self._crash()

    def _crash(self) -> bool:
        """The world model is killed; whether all that it knew is there again."""
        laboratory, found = self._laboratory, self._laboratory.found
        facts = dict(laboratory.known)
        found.facts += len(facts)
        self.end_life()
        begun = time.monotonic()
        laboratory.kill(laboratory.world)
        # What it said last may still be on its way.
        laboratory.spin(DRAINED)
        laboratory.known, heard = {}, laboratory.heard
        if laboratory.await_facts(facts, heard):
            found.recoveries.append(time.monotonic() - begun)
            return True
        lost = laboratory.missing(facts)
        found.lost += len(lost)
        laboratory.stall(f"lost {', '.join(lost)}")
        return False

    def end_life(self) -> None:
        """The world model's process ends: how its memory grew, where there was time to tell, and its runs."""
        self._laboratory.count_runs()
        hours, memory = zip(*self._memory, strict=True) if self._memory else ((), ())
        half = len(hours) // 2
        if len(hours) >= LEAST_SAMPLES:
            self._laboratory.found.growth.append(float(theilslopes(memory[half:], hours[half:])[0]))
        self._memory = []
