"""The controller: configuration, equation, solver, records, twin, reconcile, report, command line."""
