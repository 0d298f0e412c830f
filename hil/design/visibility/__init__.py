"""Which effects a sweep can show, how large, and what a change to it would add."""
