"""Hypotheses and their evidence: which sums of effects explain what the model leaves."""
