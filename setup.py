"""ament_python build of `whereabouts`: five libraries, the application over them, and its ROS share files."""

import sys
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

NAME = "whereabouts"
TOP_PACKAGES = ["estimation", "registration", "loop_closure", "tracking", "world_model", "whereabouts"]
NODES = [
    "scan_registration",
    "loop_closure",
    "target_tracker",
    "motion_predictor",
    "world_model",
    "world_maintenance",
    "verifier",
    "object_search",
]

packages = [
    package for top in TOP_PACKAGES for package in [top, *(f"{top}.{sub}" for sub in find_packages(top))]
]
# In wheels the simulation belongs to the experiments (evaluation/setup.py); elsewhere the tree stays whole.
if "bdist_wheel" in sys.argv:
    packages = [package for package in packages if not package.startswith("whereabouts.simulation")]

setup(
    name=NAME,
    version="0.2.0",
    description="ROS 2 perception suite for a mobile service robot",
    long_description=Path(__file__).with_name("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    maintainer="whereabouts maintainers",
    maintainer_email="whereabouts@example.org",
    python_requires=">=3.11,<3.14",
    packages=packages,
    package_data={
        package: ["models/*.json", "defaults/*.yaml", "presets/*.yaml", "*.html"] for package in packages
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*.*"))),
        (f"share/{NAME}/config/behavior_trees", sorted(glob("config/behavior_trees/*.xml"))),
        (f"share/{NAME}/launch", sorted(glob("launch/*.launch.py"))),
        (f"share/{NAME}/rviz", sorted(glob("rviz/*.rviz"))),
    ],
    # Ranges, so that Ubuntu's own packages satisfy them; requirements/ holds the exact versions.
    install_requires=[
        "setuptools",
        "numpy>=1.26",
        "scipy>=1.11",
        "numba>=0.58",
        "kiss-icp>=1.2",
        "small_gicp>=1.0",
        "gtsam>=4.2.1",
        "rosbags>=0.11",
        "mcap>=1.2",
        "pydantic>=2.4",
        "typer>=0.9",
        "rich>=13",
        "matplotlib>=3.6",
        "pyyaml>=6",
        "lz4>=4",
        "zstandard>=0.21",
        "pillow>=10",
        "starlette>=0.31",
        "uvicorn>=0.27",
        "websockets>=10.4",
    ],
    extras_require={
        # The nodes on a machine without a ROS installation; `make wheels` builds the messages.
        "ros": [
            "ros-rclpy[fastrtps]>=7.1,<8",
            "ros-common-interfaces>=5.3,<6",
            "whereabouts-msgs",
            "whereabouts-compat-msgs",
        ],
        # Live pictures: `whereabouts view`.
        "view": ["rerun-sdk>=0.20"],
        # Placing clouds without a guess. It has no wheels from Python 3.13 on.
        "clouds": ["kiss_matcher>=1.0; python_version < '3.13'"],
        # `whereabouts experiment`, and what compares with others.
        "evaluation": ["whereabouts-evaluation", "motmetrics>=1.4", "dask[distributed]>=2024.1"],
        # `whereabouts mcp`: Ubuntu has no package of it.
        "mcp": ["mcp>=2.3,<3"],
    },
    entry_points={
        "console_scripts": [
            "whereabouts = whereabouts.cli.main:main",
            "bring_up = whereabouts.nodes.runtime.bring_up:main",
            *(f"{node} = whereabouts.nodes.{node}_node:main" for node in NODES),
        ],
    },
    zip_safe=False,
)
