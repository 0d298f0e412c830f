"""Auditing and reproducing published tables of parameters; nothing is ever corrected: a reading is a candidate."""
