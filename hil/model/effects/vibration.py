"""Effects of vibration: rectification of what the accelerometers or a vibration channel measured."""

from collections.abc import Mapping

from hil.campaign import Conditions, FloatArray
from hil.model.effects.base import Base, Effect, Parameter
from hil.model.effects.columns import column, per_channel

_RMS = "vibration_rms_g|vibration_g"


class VibrationRectification(Effect):
    """Bias proportional to the mean square of the vibration."""

    id = "vre"
    follows = "vibration_rms_g"
    title = "Vibration rectification"
    equation = "B += K_v a_rms^2"
    per_channel = True
    parameters = (Parameter("K_v", "deg/hr/g^2", (0.1, 10.0), {"MEMS": (0.01, 1.0)}),)
    needs = frozenset({_RMS})
    signature = "Comes and goes with the chamber's compressor or fan, whose duty follows the setpoint."
    confusable_with = ("MU_T", "bias_T")
    experiment = "Stop fan and compressor during collects; log the accelerometers' rms."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        return per_channel(column(conditions, _RMS) ** 2, conditions.sensor)
