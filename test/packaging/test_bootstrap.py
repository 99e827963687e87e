"""The set-up on machines that lack something: one sentence that says what to install."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """What the set-up reads, in a place of its own."""
    copy = tmp_path / "check out"
    copy.mkdir()
    for name in ("compat", "requirements", "whereabouts_msgs"):
        shutil.copytree(ROOT / name, copy / name)
    for name in ("Makefile", "setup.py", "setup.cfg", "package.xml"):
        shutil.copy2(ROOT / name, copy / name)
    return copy


def tools(folder: Path, **scripts: str) -> Path:
    """A PATH of its own with these shell scripts and the basics."""
    folder.mkdir()
    for name in ("sh", "bash", "env", "make", "rm", "mkdir"):
        found = shutil.which(name)
        if found:
            (folder / name).symlink_to(found)
    for name, body in scripts.items():
        path = folder / name.replace("_", ".")
        path.write_text(f"#!/bin/sh\n{body}\n")
        path.chmod(0o755)
    return folder


def set_up(checkout: Path, path: Path) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "PATH": str(path)}
    for name in ("CC", "CXX", "VIRTUAL_ENV"):
        env.pop(name, None)
    command = [sys.executable, str(checkout / "compat" / "bootstrap.py"), "runtime"]
    return subprocess.run(command, capture_output=True, text=True, env=env)


def test_missing_compiler(checkout: Path, tmp_path: Path) -> None:
    answer = set_up(checkout, tools(tmp_path / "bin"))
    assert answer.returncode == 1
    assert "C compiler is missing" in answer.stdout
    assert "apt install build-essential" in answer.stdout
    only_c = set_up(checkout, tools(tmp_path / "bin2", cc="exit 0"))
    assert "C++ compiler is missing" in only_c.stdout


def test_missing_venv_module(checkout: Path, tmp_path: Path) -> None:
    python = 'if [ "$1" = "-c" ]; then echo 3.12; else echo "No module named ensurepip" >&2; exit 1; fi'
    answer = set_up(checkout, tools(tmp_path / "bin", cc="exit 0", **{"c++": "exit 0", "python3_12": python}))
    assert answer.returncode == 1
    assert "apt install python3-venv" in answer.stdout
    assert not (checkout / ".venv").exists()


def test_only_unsupported_pythons(checkout: Path, tmp_path: Path) -> None:
    shim = "echo 'command not found' >&2; exit 127"
    # In a virtual environment the running interpreter is not taken, as it may vanish with its environment.
    answer = set_up(checkout, tools(tmp_path / "bin", cc="exit 0", **{"c++": "exit 0", "python3_12": shim}))
    if sys.prefix == sys.base_prefix:
        pytest.skip("runs outside a virtual environment, where the running Python itself is taken")
    assert answer.returncode == 1
    assert "3.11, 3.12 or 3.13 is needed" in answer.stdout


def test_missing_python(checkout: Path, tmp_path: Path) -> None:
    path = tools(tmp_path / "bin")
    answer = subprocess.run(
        ["make", "setup"], capture_output=True, text=True, cwd=checkout, env={**os.environ, "PATH": str(path)}
    )
    assert answer.returncode != 0
    assert "python3 was not found" in answer.stdout + answer.stderr


def load_bootstrap() -> ModuleType:
    spec = importlib.util.spec_from_file_location("bootstrap", ROOT / "compat" / "bootstrap.py")
    assert spec is not None
    assert spec.loader is not None
    bootstrap = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(bootstrap)
    return bootstrap


def test_nothing_is_done_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """The environment of `make test` is set up: another call has nothing to run."""
    bootstrap = load_bootstrap()
    if not bootstrap.STATE.exists():
        pytest.skip("the environment was not made by the set-up")

    def refuse(command: list[object], *_: object) -> None:
        if "whereabouts.compile" in command:
            return  # Sources were edited since; that is no reason to fail.
        # Raised, not recorded: a step that fails leaves no stamp.
        raise bootstrap.SetUpError(f"would run {command}")

    monkeypatch.setattr(bootstrap, "run", refuse)
    assert bootstrap.main(["test"]) == 0


def test_what_is_left_is_estimated_from_the_pace_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    bootstrap = load_bootstrap()
    now = [100.0]
    monkeypatch.setattr(bootstrap.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(bootstrap, "SHARES", {"a": 10, "b": 30, "c": 60})
    progress = bootstrap.Progress()
    progress.plan(["a", "b", "c"])
    assert str(progress) == ""
    progress.skip("a")
    now[0] += 20.0
    progress.finish("b")
    assert str(progress) == " (33 %, about 40 s left)"
    progress.finish("c")
    assert str(progress) == ""


def test_an_interrupted_step_is_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bootstrap = load_bootstrap()
    monkeypatch.setattr(bootstrap, "STATE", tmp_path)
    monkeypatch.setattr(bootstrap, "create_environment", lambda: None)

    def interrupted(name: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(bootstrap, "install_requirements", interrupted)
    assert bootstrap.main(["test"]) == 130
    assert "goes on from here" in capsys.readouterr().out
    assert list(tmp_path.glob("*.stamp")) == []


@pytest.mark.parametrize("index", ["", "https://mirror.example/simple"])
def test_pip_takes_over_where_uv_fails_or_pip_has_its_own_index(
    monkeypatch: pytest.MonkeyPatch, index: str
) -> None:
    bootstrap = load_bootstrap()
    called: list[list[str]] = []

    def run(command: list[object], *_: object) -> None:
        called.append([str(part) for part in command])
        if called[-1][0].endswith("uv"):
            raise bootstrap.SetUpError("no index")

    monkeypatch.setattr(bootstrap, "run", run)
    monkeypatch.setenv("PIP_CONFIG_FILE", "/dev/null")
    if index:
        monkeypatch.setenv("PIP_INDEX_URL", index)
    else:
        monkeypatch.delenv("PIP_INDEX_URL", raising=False)
    bootstrap.install_requirements("test")
    asked = [command[-1] for command in called]
    before = [] if index else ["requirements/locking.txt", "requirements/test.txt"]
    assert asked == [*before, "requirements/test.txt"]
    assert called[-1][1:3] == ["-m", "pip"]
