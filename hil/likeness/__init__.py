"""Whether nights that a model simulates, through bytes, can be told from the measured one.

document = likeness(Path("night"), load_model("model.yaml"), draws=20, seed=1, keep=Path("night-twin"))
document["p_value"]
"""

from hil.likeness.draws import likeness

__all__ = ["likeness"]
