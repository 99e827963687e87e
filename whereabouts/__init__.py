"""The application over the five libraries: nodes, command line, logs and simulation."""

__version__ = "0.2.0"
