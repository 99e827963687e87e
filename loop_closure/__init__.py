"""Place features, the loop-closure classifier, candidate retrieval, pose graph and map. Knows no ROS."""

from estimation.learning.boosting import AdaBoost
from loop_closure.maps.localization import Localizer, Located
from loop_closure.maps.map_file import read_map, write_map
from loop_closure.places.comparison import PlaceDatabase, pair_features, pair_features_many
from loop_closure.places.features import PlaceFeatures, features_2d, features_3d, scan_order
from loop_closure.places.outlines import LocalMap, Outline
from loop_closure.places.place_model import PlaceModel, shipped_model
from loop_closure.places.recognizer import PlaceRecognizer
from loop_closure.slam.loop_closer import Closure
from loop_closure.slam.trajectory import Slam, SlamUpdate
from loop_closure.slam_config import SlamConfig

__all__ = [
    "AdaBoost",
    "Closure",
    "LocalMap",
    "Localizer",
    "Located",
    "Outline",
    "PlaceDatabase",
    "PlaceFeatures",
    "PlaceModel",
    "PlaceRecognizer",
    "Slam",
    "SlamConfig",
    "SlamUpdate",
    "features_2d",
    "features_3d",
    "pair_features",
    "pair_features_many",
    "read_map",
    "scan_order",
    "shipped_model",
    "write_map",
]
