"""Proof that the gap shrank: predicted where it was held out, where in the campaign, and what would settle the rest."""
