"""KISS-SLAM over the clouds of a file, in an environment of its own: its releases want older libraries than ours.

`make peers` makes that environment, `.venv-peers`. Run by its interpreter, this file reads `cloud_0`, `cloud_1`, ...
(N, 3) from the first argument and writes `poses` (M, 4, 4), processor `seconds` and the number of `closures` to the
second.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

INTERPRETER = Path(__file__).resolve().parents[2] / ".venv-peers" / "bin" / "python"
ENVIRONMENT = {"PATH": "/usr/bin:/bin", "OMP_NUM_THREADS": "1"}
"""The start-up hook of the ROS wheels would lead the other interpreter into this environment."""


def installed() -> bool:
    """Whether `make peers` was run, and KISS-SLAM can be imported there."""
    if not INTERPRETER.exists():
        return False
    command = [str(INTERPRETER), "-c", "import kiss_slam.slam"]
    return subprocess.run(command, env=ENVIRONMENT, capture_output=True, check=False).returncode == 0


def kiss_slam(clouds: list[NDArray[np.float64]]) -> tuple[NDArray[np.float64], float, int]:
    """Poses (M, 4, 4) of the clouds, processor seconds for all of them, closed loops."""
    with TemporaryDirectory() as folder:
        given, found = Path(folder) / "clouds.npz", Path(folder) / "poses.npz"
        np.savez(given, **{f"cloud_{k}": cloud.astype(np.float32) for k, cloud in enumerate(clouds)})  # type: ignore[arg-type]
        command = [str(INTERPRETER), str(Path(__file__).resolve()), str(given), str(found)]
        subprocess.run(command, check=True, env=ENVIRONMENT, stdout=subprocess.DEVNULL)
        with np.load(found) as data:
            return data["poses"], float(data["seconds"]), int(data["closures"])


def main(given: str, found: str) -> None:
    """What the other interpreter does."""
    from kiss_slam.config import load_config
    from kiss_slam.slam import KissSLAM

    with np.load(given) as data:
        clouds = [data[f"cloud_{k}"].astype(np.float64) for k in range(len(data.files))]
    slam = KissSLAM(load_config(None))
    begun = time.process_time()
    for cloud in clouds:
        slam.process_scan(cloud, np.empty(0))
    slam.generate_new_node()
    seconds = time.process_time() - begun
    poses = np.array(slam.poses)[: len(clouds)]
    np.savez(found, poses=poses, seconds=seconds, closures=len(slam.closures))


if __name__ == "__main__":
    main(*sys.argv[1:3])
