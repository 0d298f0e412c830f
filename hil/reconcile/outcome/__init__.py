"""What is said and written of a reconciliation: findings, words, page, improved model."""
