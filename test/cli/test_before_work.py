"""What is said before any work is done: the version, targets that cannot be written, packages that are missing."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import whereabouts
from registration import align_globally
from world_model.memory.store import Store

ROOT = Path(__file__).resolve().parents[2]


def command(*arguments: object, cwd: Path, without: str = "") -> subprocess.CompletedProcess[str]:
    """Run `whereabouts` as a user does; `without` : a package that cannot be imported."""
    code = (
        f"import sys; sys.modules[{without!r}] = None; from whereabouts.cli.main import main; main()"
        if without
        else "from whereabouts.cli.main import main; main()"
    )
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


def test_version_is_that_of_all_packages(tmp_path: Path) -> None:
    said = command("--version", cwd=tmp_path).stdout
    assert said == f"whereabouts {whereabouts.__version__}\n"
    for name in ("setup.py", "package.xml", "whereabouts_msgs/package.xml", "evaluation/pyproject.toml"):
        found = re.search(r"version\W+(\d+\.\d+\.\d+)", (ROOT / name).read_text(encoding="utf-8"))
        assert found is not None, name
        assert found[1] == whereabouts.__version__, name


@pytest.mark.parametrize("option", ["--out", "--json", "--closures", "--map"])
def test_a_target_that_cannot_be_written_is_refused_before_the_log_is_opened(
    option: str, tmp_path: Path
) -> None:
    answer = command("slam", "no-such-log", option, tmp_path / "missing" / "file", cwd=tmp_path)
    assert answer.returncode == 1
    assert answer.stderr == (
        f"whereabouts: {tmp_path}/missing/file: directory {tmp_path}/missing does not exist; create it first\n"
    )


def test_logs_of_run_that_cannot_be_written_are_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "log").touch()
    answer = command("run", "--logs", "log/nodes", cwd=tmp_path)
    assert answer.returncode == 1
    assert answer.stderr == f"whereabouts: log/nodes: {tmp_path}/log is a file; name a directory\n"


def test_policies_that_cannot_be_written_are_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "suite.yaml").touch()
    answer = command("security", "--out", "suite.yaml", cwd=tmp_path)
    assert answer.returncode == 1
    assert answer.stderr == "whereabouts: suite.yaml: suite.yaml is a file; name a directory\n"


def test_a_log_is_not_converted_onto_itself(tmp_path: Path) -> None:
    log = tmp_path / "drive.mcap"
    log.write_bytes(b"as recorded")
    (tmp_path / "link.mcap").symlink_to(log)
    for target in ("drive.mcap", "link.mcap"):
        answer = command("convert", "drive.mcap", target, "--seconds", 1, cwd=tmp_path)
        assert answer.returncode == 1
        assert answer.stderr == f"whereabouts: {target}: is the log that is read; name another file\n"
    assert log.read_bytes() == b"as recorded"


def test_a_missing_file_is_one_sentence(tmp_path: Path) -> None:
    answer = command("segment", "any-log", "--model", "missing.json", cwd=tmp_path)
    assert answer.returncode == 1
    assert answer.stderr == "whereabouts: missing.json: No such file or directory\n"


@pytest.mark.parametrize("option", ["--rate", "--max-range"])
def test_what_does_nothing_for_a_bag_is_refused(option: str, tmp_path: Path) -> None:
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n")
    answer = command("convert", "a.bag", "b.mcap", option, 10, cwd=tmp_path)
    assert answer.returncode == 1
    assert "are for CARMEN and g2o logs" in answer.stderr


@pytest.mark.parametrize(("name", "option"), [("mcp", "--http"), ("console", "--port")])
def test_a_port_that_is_taken_is_one_sentence(name: str, option: str, tmp_path: Path) -> None:
    Store(tmp_path / "world.sqlite").close()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        answer = command(name, "--store", "world.sqlite", option, port, cwd=tmp_path)
    assert answer.returncode == 1
    assert answer.stderr == (
        f"whereabouts: 127.0.0.1, port {port}: cannot be served: Address already in use\n"
    )


def test_a_missing_package_is_one_sentence(tmp_path: Path) -> None:
    log = ROOT / "bags" / "apartment.mcap"
    if not log.exists():
        pytest.skip("bags/apartment.mcap is not here")
    answer = command("slam", log, "--topic", "scan", cwd=tmp_path, without="gtsam")
    assert answer.returncode == 1
    assert answer.stderr.endswith(
        "whereabouts: this command needs the package gtsam: `pip install gtsam`\n"
    ), answer.stderr
    assert "Traceback" not in answer.stderr


def test_without_feature_matching_a_cloud_is_not_placed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    rng = np.random.default_rng(1)
    cloud = rng.uniform(-5.0, 5.0, (3000, 3)) * [1.0, 1.0, 0.3]
    turned = cloud @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) + [3.0, 1.0, 0.0]
    found = align_globally(cloud, turned)
    assert not found.converged
    assert found.reason
