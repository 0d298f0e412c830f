"""Rows, runs and labels that are wrong, told apart from effects that are missing."""
