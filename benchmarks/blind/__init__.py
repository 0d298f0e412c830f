"""The blind benchmark of the discrepancy workflow: hidden effects, sealed truth, scored once.

Nothing in `night.py`, `physics.py` or `cases.py` imports the product: the hidden data are made from the equations by
another hand, so that a shared sign error is seen and not cancelled.
"""
