"""The name by which users import `estimation.learning.boosting`."""

from estimation.learning.boosting import FORMAT, VERSION, AdaBoost, Stump, as_labels

__all__ = ["FORMAT", "VERSION", "AdaBoost", "Stump", "as_labels"]
