"""The application over the five libraries: nodes, command line, logs, simulation and experiments."""

__version__ = "0.2.0"
