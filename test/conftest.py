"""What holds for all tests."""

from hypothesis import settings

# On a busy machine any example may take long.
settings.register_profile("patient", deadline=None)
settings.load_profile("patient")
