"""The name by which users import `estimation.conversion.switching`."""

from estimation.conversion.switching import ConstantVelocity, SwitchingBank, SwitchingFilter

__all__ = ["ConstantVelocity", "SwitchingBank", "SwitchingFilter"]
