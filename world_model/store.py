"""The store under the name that programs know it by; it is in `memory`."""

from world_model.memory.store import HistoryEntry, Memory, Store, StoreError

__all__ = ["HistoryEntry", "Memory", "Store", "StoreError"]
