"""The second wheel: experiments and demo, and their simulated worlds."""

import sys

from setuptools import find_packages, setup

packages = ["evaluation", *(f"evaluation.{package}" for package in find_packages("."))]
folders = {"evaluation": "."}
# An editable install has the simulation from the checkout's `whereabouts`, as has a colcon workspace.
if "bdist_wheel" in sys.argv:
    rooms = find_packages("../whereabouts/simulation")
    packages += ["whereabouts.simulation", *(f"whereabouts.simulation.{room}" for room in rooms)]
    folders["whereabouts.simulation"] = "../whereabouts/simulation"

setup(
    packages=packages,
    package_dir=folders,
    package_data={"whereabouts.simulation": ["defaults/*.yaml"], "evaluation.demo": ["*.html"]},
)
