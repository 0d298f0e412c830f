"""Who turns the unit: its own index, or an operator."""
