"""ESPEC ASCII controllers (P-300, SCP-220, P-200, GL)."""
