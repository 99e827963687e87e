"""A process gives its shared memory back when it ends, and what a killed one leaves is removed."""

from __future__ import annotations

import fcntl
import os
import re
import signal
from pathlib import Path

import pytest
from harness import Graph

from whereabouts.nodes.runtime import supervisor
from whereabouts.nodes.runtime.supervisor import FOLDER, LOCK, remove_orphans
from whereabouts.system.resources import config_file


def segments(pid: int) -> list[Path]:
    """Locks of the shared-memory segments that a process holds."""
    links = {Path(os.readlink(link)) for link in Path(f"/proc/{pid}/fd").iterdir() if link.is_symlink()}
    return sorted(link for link in links if LOCK.fullmatch(link.name))


def test_a_node_that_ends_gives_its_segment_back_and_a_killed_one_has_it_removed(
    graph: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(supervisor, "YOUNG", 0.0)
    specs = graph.start("verifier"), graph.start("object_search")
    ended, killed = (graph.supervisor.nodes[spec.full_name].process for spec in specs)
    held = {process.pid: segments(process.pid) for process in (ended, killed)}
    if not held[ended.pid]:
        pytest.skip("the middleware uses no shared memory here")
    remove_orphans()
    assert all(path.exists() for paths in held.values() for path in paths)
    ended.send_signal(signal.SIGTERM)
    ended.wait()
    assert not any(path.exists() for path in held[ended.pid])
    graph.kill(specs[1])
    assert all(path.exists() for path in held[killed.pid])
    remove_orphans()
    assert not any(path.exists() for path in held[killed.pid])
    assert not any((FOLDER / path.name.removesuffix("_el")).exists() for path in held[killed.pid])


def test_only_nodes_that_send_clouds_and_maps_have_room_for_them(graph: Graph) -> None:
    sizes = []
    for name in ("verifier", "loop_closure"):
        process = graph.supervisor.nodes[graph.start(name).full_name].process
        held = [FOLDER / path.name.removesuffix("_el") for path in segments(process.pid)]
        if not held:
            pytest.skip("the middleware uses no shared memory here")
        sizes.append(max(path.stat().st_size for path in held) / 2**20)
    assert sizes[0] < 1.5
    assert sizes[1] > 7.5


def test_both_profiles_are_the_same_but_for_the_segment() -> None:
    large, small = (
        re.sub(
            r"<!--.*?-->", "", config_file(f"fastdds{kind}.xml").read_text(encoding="utf-8"), flags=re.DOTALL
        )
        for kind in ("", "_small")
    )
    sizes = r"<(maxMessageSize|segment_size)>\d+"
    assert re.sub(sizes, "", large) == re.sub(sizes, "", small).replace("small_shared", "large_shared")
    assert len(re.findall(sizes, small)) == 2


def test_only_what_nobody_holds_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor, "YOUNG", 0.0)
    names = ["fastrtps_00112233445566aa", "fastrtps_00112233445566bb", "fastrtps_port7411", "other"]
    for name in names:
        (tmp_path / name).write_bytes(b"segment")
        (tmp_path / f"{name}_el").touch()
    with (tmp_path / f"{names[0]}_el").open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert remove_orphans(tmp_path) == 1
        assert remove_orphans(tmp_path) == 0
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {name + end for name in names if name != names[1] for end in ("", "_el")}
    assert remove_orphans(tmp_path / "missing") == 0
