"""What a rate is made of: R = B + K·f + w, the earth, curves, and the catalogue of effects that a model file sums."""

from hil.model.model_file import (
    Model,
    Term,
    built_in_model,
    fitting,
    fitting_campaign,
    fitting_conditions,
    load_model,
    save_model,
)

__all__ = [
    "Model",
    "Term",
    "built_in_model",
    "fitting",
    "fitting_campaign",
    "fitting_conditions",
    "load_model",
    "save_model",
]
