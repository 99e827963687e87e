"""Builds the wheels of a checkout: `make wheels`, or `.venv/bin/python compat/wheels.py [FOLDER]`.

    whereabouts                 libraries and commands; nodes with the extra [ros]
    whereabouts_evaluation      experiments, and the simulated worlds of experiments and demo
    whereabouts_msgs            the suite's messages with their type supports, for this Python and machine
    whereabouts_compat_msgs     tf2_msgs, vision_msgs, map_msgs and nav2_msgs, for machines without a ROS installation

The last two are packed from the environment that compat/bootstrap.py has built them into.
"""

import base64
import hashlib
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
INTERFACES = {
    "whereabouts_msgs": ("whereabouts_msgs",),
    "whereabouts_compat_msgs": ("tf2_msgs", "vision_msgs", "map_msgs", "nav2_msgs"),
}
# What the generated modules need at run time; all of it comes with these two.
REQUIRES = ("ros-rclpy[fastrtps]>=7.1,<8", "ros-common-interfaces>=5.3,<6")
# Headers and CMake files are for those who compile against the messages, which wheels do not serve.
SUFFIXES = (".so", ".py", ".idl", ".msg", ".srv", ".action", ".json", ".xml", ".txt", "")


def version():
    """That of the product."""
    text = (ROOT / "whereabouts" / "__init__.py").read_text(encoding="utf-8")
    return re.search(r'__version__ = "([^"]+)"', text)[1]


def tracked_copy(folder):
    """The tracked files in another folder: what an earlier build left behind must not get into a wheel."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    for name in listed:
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def build_pure(source, out):
    """A wheel of a folder with setup.py or pyproject.toml."""
    options = ["--no-deps", "--no-build-isolation", "--disable-pip-version-check", "-q", "-w", str(out)]
    subprocess.run([sys.executable, "-m", "pip", "wheel", *options, str(source)], check=True)


def interface_files(package, prefix, site):
    """(file, place in the wheel, relative to "purelib" or "data") of a built interface package."""
    lists = [
        *sorted((site / package).rglob("*")),
        *sorted((prefix / "lib").glob(f"lib{package}__*.so")),
        *sorted((prefix / "share" / package).rglob("*")),
        *sorted((prefix / "share" / "ament_index" / "resource_index").glob(f"*/{package}")),
    ]
    for path in lists:
        # parent_prefix_path names folders of the machine that built it.
        left_out = {"__pycache__", "parent_prefix_path"} & set(path.parts)
        if not path.is_file() or left_out or path.suffix not in SUFFIXES:
            continue
        if path.is_relative_to(site):
            yield path, path.relative_to(site).as_posix()
        else:
            yield path, f"data/{path.relative_to(prefix).as_posix()}"


def build_interfaces(name, packages, out):
    """A wheel of interface packages that are built in this environment."""
    prefix, site = Path(sys.prefix), Path(sysconfig.get_path("platlib"))
    python = f"cp{sys.version_info[0]}{sys.version_info[1]}"
    platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    tag, info = f"{python}-{python}-{platform}", f"{name}-{version()}.dist-info"
    target = out / f"{name}-{version()}-{tag}.whl"
    records = []

    def add(archive, place, data):
        digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
        records.append(f"{place},sha256={digest},{len(data)}")
        # A fixed date, so that the same files are the same wheel.
        archive.writestr(zipfile.ZipInfo(place, (2026, 1, 1, 0, 0, 0)), data, zipfile.ZIP_DEFLATED)

    with zipfile.ZipFile(target, "w") as archive:
        for package in packages:
            found = list(interface_files(package, prefix, site))
            if not any(path.suffix == ".so" for path, _ in found):
                raise SystemExit(f"wheels: {package} is not built in {prefix}: run `make setup` first")
            for path, place in found:
                outside = place.startswith("data/")
                add(archive, f"{name}-{version()}.data/{place}" if outside else place, path.read_bytes())
        requires = "".join(f"Requires-Dist: {item}\n" for item in REQUIRES)
        metadata = (
            f"Metadata-Version: 2.1\nName: {name.replace('_', '-')}\nVersion: {version()}\n"
            f"Summary: ROS 2 messages for whereabouts: {', '.join(packages)}\nLicense: Apache-2.0\n"
            f"Requires-Python: =={sys.version_info[0]}.{sys.version_info[1]}.*\n{requires}"
        )
        add(archive, f"{info}/METADATA", metadata.encode())
        wheel = f"Wheel-Version: 1.0\nGenerator: whereabouts\nRoot-Is-Purelib: false\nTag: {tag}\n"
        add(archive, f"{info}/WHEEL", wheel.encode())
        records.append(f"{info}/RECORD,,\n")
        archive.writestr(zipfile.ZipInfo(f"{info}/RECORD", (2026, 1, 1, 0, 0, 0)), "\n".join(records))
    return target


def main(folder="dist"):
    out = Path(folder).resolve()
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        copy = tracked_copy(Path(temporary) / "source")
        build_pure(copy, out)
        build_pure(copy / "evaluation", out)
    for name, packages in INTERFACES.items():
        build_interfaces(name, packages, out)
    for path in sorted(out.glob("*.whl")):
        print(f"wheels: {path}")


if __name__ == "__main__":
    main(*sys.argv[1:])
