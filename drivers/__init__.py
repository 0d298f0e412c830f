"""Talking to devices, in bytes: clocks, transports, IMU frames, chambers, positioners, the device simulators."""
