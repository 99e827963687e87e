"""The rules of the tree: who may import whom, and that what is shipped is complete."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from catkin_pkg.changelog import Changelog, populate_changelog_from_rst
from catkin_pkg.cli.tag_changelog import get_forthcoming_label, rename_section
from catkin_pkg.package import parse_package

from whereabouts.node_names import NODES

ROOT = Path(__file__).resolve().parents[2]
LIBRARIES = ("estimation", "registration", "loop_closure", "tracking", "world_model")
# What each may import of the project; itself always.
ALLOWED = {
    "estimation": set(),
    "registration": {"estimation"},
    "world_model": {"estimation"},
    "loop_closure": {"estimation", "registration"},
    "tracking": {"estimation", "registration"},
    "whereabouts": set(LIBRARIES),
    "evaluation": {*LIBRARIES, "whereabouts"},
}
# What of the product may use the evaluation, which has a wheel of its own.
WITH_EVALUATION = ("whereabouts/cli",)
ROS = re.compile(
    r"(rclpy|rosidl\w*|ament_\w+|\w+_msgs|\w+_interfaces|std_srvs|tf2_ros|launch|launch_ros|rosbag2_py)(\.|$)"
)
LIVE = (
    "whereabouts/nodes",
    "test/system",
    "launch",
    "bench",
    "evaluation/chaos",
    "evaluation/demo/live",
    "evaluation/repeats.py",
)
# Commands that need a live graph reach it through whereabouts.nodes, inside the function that needs it.
COMMANDS = "whereabouts/cli"


def python_files(*folders: str) -> list[Path]:
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def imported(path: Path, top_level_only: bool = False) -> set[str]:
    """Names of modules a file imports; with `top_level_only` those loaded as soon as it is."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found: set[str] = set()
    nodes = tree.body if top_level_only else ast.walk(tree)
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found.add(node.module)
    return found


@pytest.mark.parametrize("package", ALLOWED)
def test_dependencies_point_one_way(package: str) -> None:
    files = python_files(package)
    assert files
    for path in files:
        used = {name.partition(".")[0] for name in imported(path)} & set(ALLOWED)
        place = str(path.relative_to(ROOT))
        allowed = (
            ALLOWED[package] | {package} | ({"evaluation"} if place.startswith(WITH_EVALUATION) else set())
        )
        assert used <= allowed, f"{place} imports {used}"


def test_no_ros_outside_the_nodes() -> None:
    for path in python_files(*ALLOWED, "test"):
        if any(str(path.relative_to(ROOT)).startswith(folder) for folder in LIVE):
            continue
        ros = {name for name in imported(path) if ROS.match(name) and not name.startswith("whereabouts")}
        assert not ros, f"{path.relative_to(ROOT)} imports {ros}"


def test_commands_load_nodes_only_when_they_run() -> None:
    for path in python_files(COMMANDS):
        early = {name for name in imported(path, top_level_only=True) if name.startswith("whereabouts.nodes")}
        assert not early, f"{path.relative_to(ROOT)} imports {early} at the top"


@pytest.mark.parametrize("package", [*LIBRARIES, "whereabouts", "whereabouts.logs", "whereabouts.cli.main"])
def test_importing_loads_no_ros_and_compiles_nothing(package: str) -> None:
    code = (
        f"import sys, {package}; "
        "assert 'rclpy' not in sys.modules, 'rclpy was loaded'; "
        "nb = sys.modules.get('numba'); "
        "events = [] if nb is None else [d for m in list(sys.modules.values()) "
        "for d in vars(m).values() if type(d).__name__ == 'CPUDispatcher' and d.signatures "
        "and m.__name__.split('.')[0] in ('estimation','registration','loop_closure','tracking','world_model')]; "
        "assert not events, f'compiled at import: {events}'"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert answer.returncode == 0, answer.stderr


def test_every_node_has_executable_parameter_file_and_launch_file() -> None:
    nodes = sorted(path.stem.removesuffix("_node") for path in (ROOT / "whereabouts/nodes").glob("*_node.py"))
    assert nodes == sorted(NODES)
    setup = (ROOT / "setup.py").read_text(encoding="utf-8")
    for node in nodes:
        assert f'"{node}"' in setup
        assert (ROOT / "launch" / f"{node}.launch.py").exists()
        assert (ROOT / "config" / f"{node}.yaml").exists()


def test_parameter_files_state_the_defaults() -> None:
    from whereabouts.parameters.parameter_base import model_of

    for node in NODES:
        path = ROOT / "config" / f"{node}.yaml"
        given = yaml.safe_load(path.read_text(encoding="utf-8"))["/**"]["ros__parameters"]
        defaults = model_of(node)().model_dump()
        assert given.items() <= defaults.items(), f"{path.name} does not state the defaults"
        assert tuple(given) == model_of(node).public
        assert 0 < len(given) <= 12


def test_package_names_agree_with_setup_and_package_xml() -> None:
    from xml.etree import ElementTree

    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    assert manifest.get("format") == "3"
    assert manifest.findtext("name") == "whereabouts"
    import whereabouts

    assert manifest.findtext("version") == whereabouts.__version__
    assert f'version="{whereabouts.__version__}"' in (ROOT / "setup.py").read_text(encoding="utf-8")
    dependencies = {item.text for item in manifest if item.tag.endswith("depend")}
    used = set()
    for path in python_files("whereabouts/nodes"):
        used |= {name.partition(".")[0] for name in imported(path) if ROS.match(name)}
    assert used <= dependencies


def test_interface_packages_list_all_their_files() -> None:
    for folder in (
        "whereabouts_msgs",
        "compat/tf2_msgs",
        "compat/vision_msgs",
        "compat/map_msgs",
        "compat/nav2_msgs",
    ):
        listed = set(
            re.findall(r"(?:msg|srv|action)/\w+\.\w+", (ROOT / folder / "CMakeLists.txt").read_text())
        )
        kinds = ("msg", "srv", "action")
        present = {f"{kind}/{path.name}" for kind in kinds for path in (ROOT / folder / kind).glob("*")}
        assert listed == present


def test_every_interface_field_has_a_comment() -> None:
    for path in sorted((ROOT / "whereabouts_msgs").rglob("*.*")):
        if path.suffix not in (".msg", ".srv", ".action"):
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            code = line.partition("#")[0].strip()
            constant = "=" in code
            if code and code != "---" and not constant:
                assert "#" in line, f"{path.name}:{number} has no comment: {line}"


def test_requirements_say_why() -> None:
    # lock.txt is what `make lock` makes of them.
    for path in sorted(set((ROOT / "requirements").glob("*.txt")) - {ROOT / "requirements" / "lock.txt"}):
        for line in path.read_text(encoding="utf-8").splitlines():
            if line and not line.startswith(("#", "-r")):
                assert re.fullmatch(r"[\w.\[\]-]+==\S+(; [^#]+)? +# \S.*", line), f"{path.name}: {line}"


def test_what_pip_would_install_rosdep_or_the_recipe_for_ros_machines_does() -> None:
    from xml.etree import ElementTree

    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    keys = {item.text or "" for item in manifest if item.tag.endswith("depend")}
    recipe = (ROOT / "docs/installation.md").read_text(encoding="utf-8").partition("## On a ROS 2 Jazzy")[2]
    named = set(re.search(r"pip install ((?:[\w-]+ )+)", recipe)[1].split())  # type: ignore[index]
    skipped = set(re.search(r'--skip-keys "(.*?)"', recipe)[1].split())  # type: ignore[index]
    setup = (ROOT / "setup.py").read_text(encoding="utf-8")
    listed = re.search(r"install_requires=\[(.*?)\]", setup, re.DOTALL)[1]  # type: ignore[index]
    other = {"pyyaml": "yaml", "pillow": "pil"}
    for name in re.findall(r'"([A-Za-z0-9_-]+)', listed):
        if name == "setuptools":
            continue
        key = f"python3-{other.get(name, name)}"
        assert key in keys or name in named, f"{name}: neither in package.xml nor in the recipe"
    assert skipped == {key for key in keys if key.endswith("-pip")}
    assert {key.removeprefix("python3-").removesuffix("-pip") for key in skipped} <= named
    assert {"nav2_msgs", "rviz2", "rosbag2", "std_srvs"} <= keys


@pytest.mark.parametrize("folder", [".", "whereabouts_msgs"])
def test_both_packages_are_ready_for_a_release(folder: str) -> None:
    """As bloom's tools read them: what is `Forthcoming` becomes the next version, before that of package.xml."""
    package = parse_package(ROOT / folder)
    text = (ROOT / folder / "CHANGELOG.rst").read_text(encoding="utf-8")
    released = rename_section(text, get_forthcoming_label(text), "99.0.0 (2026-11-26)")
    changelog = Changelog(package.name)
    populate_changelog_from_rst(changelog, released)
    assert {str(version) for version, _, _ in changelog.foreach_version()} == {"99.0.0", package.version}
    assert changelog.get_content_of_version(package.version)
    assert package.version == parse_package(ROOT).version
