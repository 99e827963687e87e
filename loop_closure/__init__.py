"""Place features, the loop-closure classifier, candidate retrieval, pose graph and map. Knows no ROS."""

from estimation.boosting import AdaBoost
from loop_closure.comparison import PlaceDatabase, pair_features, pair_features_many
from loop_closure.features import PlaceFeatures, features_2d, features_3d, scan_order
from loop_closure.recognizer import PlaceRecognizer

__all__ = [
    "AdaBoost",
    "PlaceDatabase",
    "PlaceFeatures",
    "PlaceRecognizer",
    "features_2d",
    "features_3d",
    "pair_features",
    "pair_features_many",
    "scan_order",
]
