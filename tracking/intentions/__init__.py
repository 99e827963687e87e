"""Motion prediction: intended positions learned from watching, and paths by social forces. Knows no ROS."""

from tracking.intentions.intention_config import IntentionConfig
from tracking.intentions.intention_model import IntentionModel, LearnedIntentions
from tracking.intentions.prediction import PredictedWay, Prediction
from tracking.intentions.printed import PrintedModel as _PrintedModel  # noqa: F401 - its method is known by this

__all__ = ["IntentionConfig", "IntentionModel", "LearnedIntentions", "PredictedWay", "Prediction"]
