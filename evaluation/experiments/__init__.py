"""One module per table or figure of the reference texts; each prints theirs beside ours.

An experiment is a module here with

* a docstring whose first line says what it shows,
* `PARTS`, the parts it is run in, by name.

`whereabouts experiment NAME` finds it by its module name.
"""
