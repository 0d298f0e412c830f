"""Simulated chambers: one file per controller, all before the same plant."""
