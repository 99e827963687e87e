"""Fixtures of the system tests."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

import pytest
from harness import Graph

from whereabouts.nodes.ros.host import Forked, Host
from whereabouts.nodes.runtime import supervisor
from whereabouts.nodes.runtime.domain import free_domain, release_domain
from whereabouts.system.resources import config_file

RESTING = 20  # domains that nobody takes for a while after a test has left them
LEFT: deque[int] = deque()


class Lent:
    """The host that all tests of this process fork their nodes from: they are imported and loaded once."""

    def __init__(self) -> None:
        self._host: Host | None = None
        self._broken: OSError | None = None

    def lend(self) -> Lent:
        """In place of a host of one's own."""
        return self

    @property
    def pid(self) -> int | None:
        return None if self._host is None else self._host.pid

    def wait(self) -> None:
        """A test is not interrupted while it loads."""

    def start(self, command: list[str], log: Path, environment: Mapping[str, str]) -> Forked:
        """Raises OSError where there is no host, or no longer; nodes then start alone."""
        if self._broken is not None:
            raise self._broken
        if command[1] != "-m":
            raise OSError("only modules are forked")
        try:
            self._host = self._host or Host()
            return self._host.start(command, log, environment)
        except OSError as error:
            self._broken = error
            raise

    def end(self) -> None:
        """Whoever borrows it does not end it."""

    def close(self) -> None:
        if self._host is not None:
            with suppress(OSError):
                self._host.end()


@pytest.fixture(scope="session")
def lent() -> Iterator[Lent]:
    host = Lent()
    yield host
    host.close()


@pytest.fixture(autouse=True)
def one_host(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, lent: Lent) -> None:
    """Nodes are forked from one host, but where tests are about the host itself."""
    if request.path.name != "test_host.py":
        monkeypatch.setattr(supervisor, "Host", lent.lend)


@pytest.fixture(autouse=True)
def domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A domain of its own for every test, on this machine only; none of the last, where somebody may still speak."""
    number = free_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(config_file("fastdds.xml")))
    yield number
    LEFT.append(number)
    if len(LEFT) > RESTING:
        release_domain(LEFT.popleft())


@pytest.fixture
def graph(domain: int, tmp_path: Path) -> Iterator[Graph]:
    made = Graph(tmp_path / "logs")
    yield made
    made.close()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    for item in items:
        if here in item.path.parents:
            item.add_marker(pytest.mark.system)
