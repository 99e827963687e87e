"""The application over the five libraries: nodes, command line, logs, simulation and experiments."""

__version__ = "0.1.0"
