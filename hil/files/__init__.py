"""How text and bytes cross the border: strict YAML by name, units, durable writing, locks, figures."""
