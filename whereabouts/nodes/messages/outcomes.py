"""How services say that nothing came of a request."""

from __future__ import annotations

from typing import Any


def decline(response: Any, sentence: str, code: str = "FAILED") -> bool:
    """Write into a response why nothing was done; whether it has a place for that.

    The suite's own services have a code and a message, those of std_srvs success and a message, others neither. An
    answer of nav2's that says nothing would say success.
    """
    if hasattr(response, "RESULT_UNDEFINED_FAILURE"):
        response.result = response.RESULT_UNDEFINED_FAILURE
        return False
    if hasattr(response, "code"):
        response.code, response.message = getattr(response, code), sentence
        return True
    if hasattr(response, "success"):
        response.success, response.message = False, sentence
        return True
    return False
