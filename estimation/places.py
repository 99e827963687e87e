"""The name by which users import `estimation.geometry.places`."""

from estimation.geometry.places import ANY_HEIGHT, KINDS, LIKELY, Place, Places

__all__ = ["ANY_HEIGHT", "KINDS", "LIKELY", "Place", "Places"]
