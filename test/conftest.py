"""What holds for all tests."""

from importlib.util import find_spec

import pytest
from hypothesis import settings

# On a busy machine any example may take long.
settings.register_profile("patient", deadline=None)
settings.load_profile("patient")


@pytest.fixture
def kiss_matcher() -> None:
    """What places clouds without a guess; optional, as it has no wheel for every Python and machine."""
    if find_spec("kiss_matcher") is None:
        pytest.skip("kiss_matcher is not installed: docs/platforms.md says where it can be")
