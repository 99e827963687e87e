"""Motion prediction: intended positions learned from watching, and paths by social forces. Knows no ROS."""

from tracking.intentions.intention_config import IntentionConfig
from tracking.intentions.intention_model import IntentionModel, LearnedIntentions
from tracking.intentions.prediction import PredictedWay, Prediction

__all__ = ["IntentionConfig", "IntentionModel", "LearnedIntentions", "PredictedWay", "Prediction"]
