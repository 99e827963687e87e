"""Motion prediction: intended positions learned from watching, and paths by social forces. Knows no ROS."""

from tracking.intentions.config import IntentionConfig
from tracking.intentions.model import IntentionModel, Learned
from tracking.intentions.prediction import PredictedWay, Prediction

__all__ = ["IntentionConfig", "IntentionModel", "Learned", "PredictedWay", "Prediction"]
