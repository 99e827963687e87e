"""Anchors, hypotheses, memory, maintenance and object search. Knows no ROS."""

from world_model.config import WorldModelConfig
from world_model.evidence import ObjectEvidence, WorldEvidence
from world_model.memory.routines import Routines, RoutinesConfig
from world_model.model import WorldModel
from world_model.questions import ask
from world_model.state import WorldObject, WorldState
from world_model.store import Store
from world_model.symbols import Symbols
from world_model.tasks.looks import Sensor
from world_model.tasks.maintenance import Maintenance, MaintenanceConfig, Trigger, VerificationTask
from world_model.tasks.relations import Relations
from world_model.tasks.search import ObjectSearch, SearchConfig, SearchStep

__all__ = [
    "Maintenance",
    "MaintenanceConfig",
    "ObjectEvidence",
    "ObjectSearch",
    "Relations",
    "Routines",
    "RoutinesConfig",
    "SearchConfig",
    "SearchStep",
    "Sensor",
    "Store",
    "Symbols",
    "Trigger",
    "VerificationTask",
    "WorldEvidence",
    "WorldModel",
    "WorldModelConfig",
    "WorldObject",
    "WorldState",
    "ask",
]
