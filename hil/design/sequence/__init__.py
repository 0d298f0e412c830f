"""Which sequence of collects serves a goal within a time."""
