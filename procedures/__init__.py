"""What a technician does, in steps: plan, restabilisation, collect, self-calibration, sweep."""
