"""The wheels that `make wheels` builds: complete metadata, and a product that runs in an empty environment."""

from __future__ import annotations

import ast
import email
import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from estimation.geometry.poses import between
from evaluation.scenes.small_robot import record
from whereabouts.logs import read_tum

ROOT = Path(__file__).resolve().parents[2]
PRODUCT = ("estimation", "registration", "loop_closure", "tracking", "world_model", "whereabouts")
# Names of imports whose packages are called otherwise.
PACKAGES = {
    "PIL": "pillow",
    "mcp_types": "mcp",
    "yaml": "pyyaml", "rerun": "rerun-sdk", "evaluation": "whereabouts-evaluation", "distributed": "dask",
    "llvmlite": "numba",
}  # fmt: skip
# What comes with those that are named, or only with ROS.
ALONG = {
    "ament_index_python",
    "launch",
    "launch_ros",
    "rosidl_runtime_py",
    "rclpy",
    "std_srvs",
    "click",
    "annotated_types",
}


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run([sys.executable, ROOT / "compat" / "wheels.py", folder], check=True, cwd=ROOT)
    return folder


def metadata(wheel: Path) -> email.message.Message:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [item for item in archive.namelist() if item.endswith(".dist-info/METADATA")]
        return email.message_from_bytes(archive.read(name))


def test_all_that_is_imported_is_named(dist: Path) -> None:
    (wheel,) = dist.glob("whereabouts-*.whl")
    about = metadata(wheel)
    named = {
        re.split(r"[^\w.-]", line)[0].lower().replace("_", "-") for line in about.get_all("Requires-Dist", [])
    }
    imported = set()
    for path in (path for name in PRODUCT for path in (ROOT / name).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                imported |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                imported.add(node.module.partition(".")[0])
    others = {
        name
        for name in imported - set(sys.stdlib_module_names) - set(PRODUCT) - ALONG
        if not name.endswith("_msgs") and not name.endswith("_interfaces")
    }
    missing = {name for name in others if PACKAGES.get(name, name).lower().replace("_", "-") not in named}
    assert not missing
    assert set(about.get_all("Provides-Extra", [])) == {"ros", "view", "clouds", "evaluation", "mcp"}
    assert set(about["Requires-Python"].split(",")) == {">=3.11", "<3.14"}


def test_only_the_second_wheel_has_experiments_and_simulated_worlds(dist: Path) -> None:
    (product,) = dist.glob("whereabouts-*.whl")
    (second,) = dist.glob("whereabouts_evaluation-*.whl")
    beside = [
        path.relative_to(ROOT).as_posix()
        for folder in ("whereabouts/simulation", "evaluation")
        for path in (ROOT / folder).rglob("*")
        if path.suffix in (".py", ".yaml", ".html") and path.name != "setup.py"
    ]
    assert len(beside) > 30
    assert not {*beside} & {*zipfile.ZipFile(product).namelist()}
    assert {*beside} <= {*zipfile.ZipFile(second).namelist()}


def test_messages_carry_their_type_supports(dist: Path) -> None:
    (wheel,) = dist.glob("whereabouts_msgs-*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert "whereabouts_msgs/msg/_world_state.py" in names
    assert any(name.endswith("/lib/libwhereabouts_msgs__rosidl_typesupport_fastrtps_c.so") for name in names)
    assert any(re.search(r"^whereabouts_msgs/.*typesupport_fastrtps_c.*\.so$", name) for name in names)


def pinned() -> dict[str, str]:
    """Versions of the lock file for this Python and machine."""
    found = {}
    for line in (ROOT / "requirements" / "lock.txt").read_text(encoding="utf-8").splitlines():
        match = re.match(r"^([\w.-]+)==([^ ;\\]+)(?: ; python_full_version (<|>=) '3\.(\d+)')?", line)
        if match is None:
            continue
        name, version, relation, minor = match.groups()
        newer = minor is not None and sys.version_info[1] >= int(minor)
        if relation is None or newer == (relation == ">="):
            found[name] = version
    return found


def test_the_lock_file_has_what_the_requirements_name_with_hashes() -> None:
    locked = pinned()
    for file in ("runtime.txt", "build.txt"):
        for line in (ROOT / "requirements" / file).read_text(encoding="utf-8").splitlines():
            match = re.match(
                r'^([\w.-]+)(?:\[\w+\])?==([^ ;#]+)(?:; python_version (<|>=) "3\.(\d+)")?', line
            )
            if match is None:
                continue
            name, version, relation, minor = match.groups()
            if relation is None or (sys.version_info[1] >= int(minor)) == (relation == ">="):
                assert locked[name.lower().replace("_", "-")] == version, f"make lock: {name}"
    text = (ROOT / "requirements" / "lock.txt").read_text(encoding="utf-8")
    entries = re.split(r"\n(?=[\w.-]+==)", text)
    assert len(entries) > 50
    assert all("--hash=sha256:" in entry for entry in entries)


ENVIRONMENT = {
    key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "_ROS", "AMENT"))
}


def attempt(folder: Path, *command: object) -> subprocess.CompletedProcess[str]:
    """A command in a folder, with nothing of this environment."""
    return subprocess.run([*map(str, command)], capture_output=True, text=True, cwd=folder, env=ENVIRONMENT)


def run(folder: Path, *command: object) -> str:
    """What a command writes that has to succeed."""
    answer = attempt(folder, *command)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    return answer.stdout


def install(venv: Path, dist: Path, *what: object) -> None:
    """From the package index, and what `make wheels` builds; in the versions of the lock file."""
    versions = venv.parent / "constraints.txt"
    versions.write_text("".join(f"{name}=={version}\n" for name, version in pinned().items()))
    # Modules that are imported are compiled then; most never are.
    options = ["-q", "--no-compile", "--constraint", versions, "--find-links", dist]
    run(venv.parent, venv / "bin/pip", "install", *options, *what)
    run(venv.parent, venv / "bin/pip", "check")


def bring_compiled(venv: Path) -> None:
    """What this checkout has compiled, for the same files there: that functions compile is another test's matter."""
    (there,) = venv.glob("lib/python*/site-packages")
    for name in (*PRODUCT, "evaluation"):
        for source in (ROOT / name).rglob("*.py"):
            installed = there / source.relative_to(ROOT)
            compiled = list((source.parent / "__pycache__").glob(f"{source.stem}.*.nb[ci]"))
            if compiled and installed.exists() and installed.read_bytes() == source.read_bytes():
                shutil.copystat(source, installed)  # numba tells files by their time
                (installed.parent / "__pycache__").mkdir(exist_ok=True)
                for path in compiled:
                    shutil.copy2(path, installed.parent / "__pycache__")


@pytest.mark.timeout(1200)
def test_the_product_runs_in_an_empty_environment(dist: Path, tmp_path: Path) -> None:
    """Nothing but the wheels and what their metadata name, from the package index."""
    (wheel,) = dist.glob("whereabouts-*.whl")
    venv, bag, out = tmp_path / "venv", tmp_path / "drive.mcap", tmp_path / "drive.tum"
    command, settings = venv / "bin/whereabouts", tmp_path / "robot.yaml"
    truth = record(bag, duration=20.0)
    run(tmp_path, sys.executable, "-m", "venv", venv)
    install(venv, dist, wheel)
    bring_compiled(venv)
    assert run(tmp_path, command, "--version").startswith("whereabouts ")
    run(tmp_path, command, "setup", bag, "--out", settings)
    run(tmp_path, command, "slam", bag, "--params", settings, "--out", out, "--map", tmp_path / "map.png")
    expected = np.array([between(truth[0, 1:], row[1:])[:2] for row in truth])
    assert np.abs(read_tum(out).se2()[:, :2] - expected).max() < 0.05
    run(tmp_path, command, "track", bag, "--out", tmp_path / "tracks.csv")
    assert "not installed" in run(tmp_path, command, "doctor", bag), "there is no ROS there"

    install(venv, dist, f"{wheel}[ros,evaluation]")
    bring_compiled(venv)
    figures, report = tmp_path / "demo.json", tmp_path / "report"
    demo = (command, "demo", "--seconds", 12, "--out", report, "--json", figures)
    run(tmp_path, *demo)
    found = json.loads(figures.read_text(encoding="utf-8"))
    assert found["bag_s"] == 12.0
    assert found["nodes_heard"] == 8
    assert (found["lost"], found["unanswered"]) == (0, 0)
    assert found["loops_closed_rmse_m"] < 0.05
    assert found["things_right"] >= 2
    assert "target_tracker" in (report / "index.html").read_text(encoding="utf-8")

    (node,) = venv.glob("lib/python*/site-packages/whereabouts/nodes/verifier_node.py")
    node.unlink()
    without = attempt(tmp_path, *demo)
    assert without.returncode != 0
    assert "verifier" in without.stderr


def test_nobody_is_told_to_install_the_other_project_of_this_name() -> None:
    """PyPI's `whereabouts` is somebody else's: no message or front page may send people there."""
    for path in [ROOT / "README.md", *(ROOT / "whereabouts").rglob("*.py")]:
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"pip install (-\S+ )*['\"]?whereabouts\b(?!-)", text), path
    for page in ("platforms.md", "installation.md"):
        assert "PyPI has another project" in (ROOT / "docs" / page).read_text(encoding="utf-8")
