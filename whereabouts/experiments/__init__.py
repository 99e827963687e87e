"""One module per table or figure of the reference texts; each prints theirs beside ours.

An experiment is a module here with

* a docstring whose first line says what it shows,
* `run(options: Options) -> Report`.

`whereabouts experiment NAME` finds it by its module name.
"""

from whereabouts.experiments.report import Options, Report, Table

__all__ = ["Options", "Report", "Table"]
