"""What a technician does: plan, restabilisation, collect, self-calibration, sweep.

This floor knows steps, not devices' bytes and not equations. It imports only from `drivers`.
"""
