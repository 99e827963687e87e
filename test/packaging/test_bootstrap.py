"""The set-up on machines that lack something: one sentence that says what to install."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import time
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
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, index: str
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
    monkeypatch.setattr(bootstrap, "STATE", tmp_path)
    bootstrap.install_requirements("test")
    asked = [command[-1] for command in called]
    before = [] if index else ["requirements/locking.txt", "requirements/test.txt"]
    assert asked == [*before, "requirements/test.txt"]
    assert called[-1][1:3] == ["-m", "pip"]


def test_an_installation_that_was_interrupted_is_made_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it was writing looks installed to uv and pip, and lacks files."""
    bootstrap = load_bootstrap()
    monkeypatch.setattr(bootstrap, "STATE", tmp_path)
    monkeypatch.setattr(bootstrap, "own_index", lambda env: False)
    called: list[list[str]] = []
    interrupts = [KeyboardInterrupt()]

    def run(command: list[object], *_: object) -> None:
        called.append([str(part) for part in command])
        if called[-1][0].endswith("uv") and interrupts:
            raise interrupts.pop()

    monkeypatch.setattr(bootstrap, "run", run)
    with pytest.raises(KeyboardInterrupt):
        bootstrap.install_requirements("runtime")
    assert not any("--reinstall" in command for command in called)
    # Another command of make, with other requirements, finds the same environment.
    bootstrap.install_requirements("test")
    assert "--reinstall" in called[-1]
    bootstrap.install_requirements("test")
    assert "--reinstall" not in called[-1]


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ("OSError: [Errno 28] No space left on device", "the disk is full"),
        ("WARNING: Retrying after connection broken by 'X'\nERROR: No matching distribution", "the network"),
    ],
)
def test_a_fault_of_the_machine_is_told_before_the_end_of_the_log(
    tmp_path: Path, said: str, told: str
) -> None:
    bootstrap = load_bootstrap()
    script = f"print({said!r}); raise SystemExit(1)"
    with pytest.raises(bootstrap.SetUpError, match=told) as failure:
        bootstrap.run([sys.executable, "-c", script], tmp_path / "log")
    assert said.splitlines()[-1] in str(failure.value)


def test_pip_does_not_try_again_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bootstrap = load_bootstrap()
    monkeypatch.setattr(bootstrap, "STATE", tmp_path)
    monkeypatch.setattr(bootstrap, "own_index", lambda env: False)
    called: list[str] = []

    def run(command: list[object], *_: object) -> None:
        called.append(str(command[0]))
        if called[-1].endswith("uv"):
            said = "No space left on device (os error 28)"
            raise bootstrap.SetUpError(f"{bootstrap.advice(said)}.\n{said}")

    monkeypatch.setattr(bootstrap, "run", run)
    with pytest.raises(bootstrap.SetUpError, match="the disk is full"):
        bootstrap.install_requirements("test")
    assert called[-1].endswith("uv")


def test_a_folder_that_cannot_be_written_to_is_no_missing_module(checkout: Path, tmp_path: Path) -> None:
    said = "Error: [Errno 30] Read-only file system"
    python = f'if [ "$1" = "-c" ]; then echo 3.12; else echo "{said}" >&2; exit 1; fi'
    answer = set_up(checkout, tools(tmp_path / "bin", cc="exit 0", **{"c++": "exit 0", "python3_12": python}))
    assert answer.returncode == 1
    assert "clone into another" in answer.stdout
    assert "apt install" not in answer.stdout


WORKS = """
import signal, subprocess, sys, time
signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a compiler that swallows the interrupt
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(100)"])
open(sys.argv[1], "w").write(str(child.pid))
child.wait()
"""


def is_running(pid: int) -> bool:
    """Whether a process is there and is no corpse that nobody has fetched."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.parametrize("ends", [KeyboardInterrupt, "SetUpError"])
def test_what_runs_beside_ends_with_the_set_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ends: type[BaseException] | str
) -> None:
    """A program that does not heed Ctrl-C, and what it has started, hold nothing up and are not left behind."""
    bootstrap = load_bootstrap()
    monkeypatch.setattr(bootstrap, "STATE", tmp_path / "state")
    monkeypatch.setattr(bootstrap, "create_environment", lambda: None)
    monkeypatch.setattr(bootstrap, "install_requirements", lambda name: None)
    note, error = tmp_path / "pid", bootstrap.SetUpError if isinstance(ends, str) else ends
    monkeypatch.setattr(
        bootstrap,
        "compile_functions",
        lambda: bootstrap.run([sys.executable, "-c", WORKS, note], tmp_path / "log"),
    )

    def build(folder: str) -> None:
        while not (note.exists() and note.read_text()):
            time.sleep(0.01)
        raise error("a build failed")

    monkeypatch.setattr(bootstrap, "build_interfaces", build)
    started = time.monotonic()
    assert bootstrap.main(["runtime"]) == (130 if error is KeyboardInterrupt else 1)
    assert time.monotonic() - started < 20.0
    pid = int(note.read_text())
    while is_running(pid):
        assert time.monotonic() - started < 20.0
        time.sleep(0.01)
