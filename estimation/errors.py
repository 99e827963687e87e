"""The one family of typed errors: bad input says which argument it was and what is allowed."""

from __future__ import annotations


class WhereaboutsError(Exception):
    """Base of every error this project raises on purpose."""


class InputError(WhereaboutsError, ValueError):
    """An argument has the wrong shape, range or content; the message names it and the allowed values."""
