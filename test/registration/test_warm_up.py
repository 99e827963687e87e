"""The scans that warm registration up are ones it can follow."""

from __future__ import annotations

import numpy as np

from registration.odometry.follower import Odometry
from registration.registration_warm_up import room_scan, warm_up


def testroom_scans_are_of_a_room() -> None:
    points = room_scan(-1.0).points() + np.array([-1.0, 0.0])
    on_wall = np.minimum(np.abs(points[:, 0] - 4.0), np.abs(np.abs(points[:, 1]) - 3.0))
    assert on_wall.max() < 1e-6


def test_after_it_nothing_is_compiled_for_the_first_scans() -> None:
    from numba.core.registry import CPUDispatcher

    warm_up()
    dispatchers = [item for item in _module_items() if isinstance(item, CPUDispatcher)]
    before = {id(item): len(item.signatures) for item in dispatchers}
    odometry = Odometry()
    for step in range(3):
        odometry.register(room_scan(0.2 * step), float(step))
    assert {id(item): len(item.signatures) for item in dispatchers} == before


def _module_items() -> list[object]:
    import sys

    names = [name for name in sys.modules if name.split(".")[0] in ("registration", "estimation")]
    return [item for name in names for item in vars(sys.modules[name]).values()]
