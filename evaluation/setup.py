"""The second wheel: experiments, and the simulated worlds of experiments and demo."""

import sys

from setuptools import setup

packages = ["evaluation", "evaluation.chaos", "evaluation.experiments"]
folders = {"evaluation": "."}
# An editable install has the simulation from the checkout's `whereabouts`, as has a colcon workspace.
if "bdist_wheel" in sys.argv:
    packages.append("whereabouts.simulation")
    folders["whereabouts.simulation"] = "../whereabouts/simulation"

setup(packages=packages, package_dir=folders, package_data={"whereabouts.simulation": ["defaults/*.yaml"]})
