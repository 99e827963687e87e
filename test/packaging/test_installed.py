"""The package as others install it: a wheel outside the checkout, and a colcon workspace."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("estimation", "registration", "loop_closure", "tracking", "world_model", "whereabouts")


def checked(command: list[str], **options: object) -> str:
    answer = subprocess.run(command, capture_output=True, text=True, **options)  # type: ignore[call-overload]
    assert answer.returncode == 0, answer.stdout + answer.stderr
    return str(answer.stdout)


def build_wheel(source: Path, folder: Path) -> None:
    """A wheel of a folder with a setup.py or pyproject.toml."""
    options = ["--no-deps", "--no-build-isolation", "-q", "-w", str(folder)]
    checked([sys.executable, "-m", "pip", "wheel", *options, str(source)])


@pytest.fixture(scope="module", autouse=True)
def nothing_else() -> Iterator[None]:
    """A path that somebody has set would put the checkout before what is installed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("PYTHONPATH", raising=False)
        yield


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the tracked files, so that building leaves nothing in the checkout."""
    copy = tmp_path_factory.mktemp("source") / "whereabouts"
    names = checked(["git", "ls-files", "--cached", "--others", "--exclude-standard"], cwd=ROOT).splitlines()
    for name in names:
        if (ROOT / name).is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, copy / name)
    return copy


@pytest.fixture(scope="module")
def installed(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual environment with the wheel in it, and this one's other packages within reach."""
    folder = tmp_path_factory.mktemp("wheel")
    build_wheel(source, folder)
    venv = folder / "venv"
    checked([sys.executable, "-m", "venv", "--without-pip", str(venv)])
    python = venv / "bin" / "python"
    wheel = next(folder.glob("*.whl"))
    checked([sys.executable, "-m", "pip", "--python", str(python), "install", "--no-deps", "-q", str(wheel)])
    site = next((venv / "lib").glob("python*/site-packages"))
    # A plain path line: packages are found, start-up hooks and the editable install of this environment are not.
    (site / "others.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return venv


def test_wheel_carries_all_packages_and_their_data(installed: Path, tmp_path: Path) -> None:
    code = (
        f"import importlib; ms = [importlib.import_module(n) for n in {PACKAGES!r}]; "
        "from whereabouts.system.resources import config_file; "
        "print('\\n'.join([m.__file__ for m in ms] + [str(config_file('fastdds.xml'))]))"
    )
    found = checked([str(installed / "bin/python"), "-c", code], cwd=tmp_path).splitlines()
    assert len(found) == len(PACKAGES) + 1
    assert all(Path(path).is_relative_to(installed) for path in found)
    data = [
        path
        for name in PACKAGES
        for kind in ("models", "defaults")
        for path in (ROOT / name).glob(f"**/{kind}/*")
        if "simulation" not in path.parts
    ]
    site = Path(found[0]).parents[1]
    assert all((site / path.relative_to(ROOT)).exists() for path in data)


def test_commands_of_the_wheels_run_outside_the_checkout(
    source: Path, installed: Path, tmp_path: Path
) -> None:
    listing = [str(installed / "bin/whereabouts"), "experiment", "list"]
    alone = subprocess.run(listing, capture_output=True, text=True, cwd=tmp_path)
    assert alone.returncode == 1
    assert alone.stderr.startswith("whereabouts: this command needs the package whereabouts-evaluation")
    living = [str(installed / "bin/whereabouts"), "demo", "--weeks", "1", "--out", str(tmp_path / "weeks")]
    alone = subprocess.run(living, capture_output=True, text=True, cwd=tmp_path)
    assert alone.stderr.startswith("whereabouts: this command needs the package whereabouts-evaluation")
    worlds = [str(installed / "bin/python"), "-c", "import whereabouts.simulation as s; print(s.__file__)"]
    assert subprocess.run(worlds, capture_output=True, cwd=tmp_path).returncode
    build_wheel(source / "evaluation", tmp_path)
    wheel, python = next(tmp_path.glob("*.whl")), installed / "bin/python"
    checked([sys.executable, "-m", "pip", "--python", str(python), "install", "--no-deps", "-q", str(wheel)])
    assert "conversion" in checked(listing, cwd=tmp_path)
    assert Path(checked(worlds, cwd=tmp_path).strip()).is_relative_to(installed)
    command = [str(installed / "bin/scan_registration"), "--ros-args", "-p", "max_range:=-1.0"]
    answer = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert answer.returncode == 2
    assert "max_range: float from 0.5 to 1000 m expected, got -1.0" in answer.stderr


@pytest.fixture
def other_python(tmp_path: Path) -> Path:
    """The machine's Python with colcon and without the suite's libraries, as ROS 2 installs it."""
    base = "/usr/bin/python3" if Path("/usr/bin/python3").exists() else sys.executable
    checked([base, "-m", "venv", "--without-pip", str(tmp_path / "system")])
    site = next((tmp_path / "system/lib").glob("python*/site-packages"))
    for item in Path(sysconfig.get_path("purelib")).iterdir():
        if item.suffix != ".pth" and not item.name.startswith(("numpy", "numba", "rclpy", "__editable__")):
            (site / item.name).symlink_to(item)
    return tmp_path / "system/bin/python3"


def test_colcon_finds_and_builds_the_packages_in_a_folder_of_any_name(
    source: Path, other_python: Path, tmp_path: Path
) -> None:
    whole, source = source, tmp_path / "Büro neu" / "src"
    shutil.copytree(whole, source)
    start = "import sys; from colcon_core.command import main; sys.argv[0] = 'colcon'; sys.exit(main())"
    colcon = [str(other_python), "-c", start, "--log-base", str(tmp_path / "log")]
    assert subprocess.run([str(other_python), "-c", "import rclpy"], capture_output=True).returncode
    # The user has activated the environment.
    env = {**os.environ, "COLCON_DEFAULTS_FILE": str(source / "colcon_defaults.yaml")}
    env["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{env['PATH']}"
    env.pop("PYTHONPATH", None)
    found = checked([*colcon, "list"], cwd=source, env=env).split("\n")
    assert "whereabouts\t.\t(ros.ament_python)" in found
    assert "whereabouts_msgs\twhereabouts_msgs\t(ros.ament_cmake)" in found
    # The interface package takes a compiler a minute and is in the environment already: `make colcon` builds both.
    (source / "whereabouts_msgs" / "COLCON_IGNORE").touch()
    checked([*colcon, "build", "--packages-select", "whereabouts"], cwd=source, env=env)
    prefix = source / "install" / "whereabouts"
    share = prefix / "share/whereabouts"
    assert (share / "launch/suite.launch.py").exists()
    assert (share / "config/behavior_trees/find_object.xml").exists()
    assert (prefix / "share/ament_index/resource_index/packages/whereabouts").exists()
    # Whatever Python colcon has: the environment's comes first when the nodes are started.
    for path in (prefix / "lib/whereabouts").iterdir():
        assert path.read_text(encoding="utf-8").splitlines()[0] == "#!/usr/bin/env python3", path.name
    recipe = (ROOT / "docs/installation.md").read_text(encoding="utf-8").partition("## On a ROS 2 Jazzy")[2]
    (sourced,) = re.findall(r"^(\. install/\S+) &&", recipe, re.MULTILINE)
    code = "import whereabouts; print(whereabouts.__file__)"
    script = (
        f"{sourced} && (cd / && python3 -c '{code}') && install/whereabouts/lib/whereabouts/scan_registration"
    )
    answer = subprocess.run(
        ["bash", "-c", f"{script} --ros-args -p transform_timeout:=77.0"],
        capture_output=True,
        text=True,
        cwd=source,
        env=env,
    )
    assert answer.returncode == 2, answer.stderr
    assert "transform_timeout" in answer.stderr
    assert Path(answer.stdout.strip()).is_relative_to(prefix), "the workspace's own package is used"
