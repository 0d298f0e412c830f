"""Talking to devices: clocks, transports, IMU frames, chambers, positioners, and the device simulators.

This floor knows bytes, not calibrations. It imports nothing from `procedures` or `hil`.
"""
