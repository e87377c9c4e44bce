"""The verbs of a calibration: `hil calibrate` and `hil verify`."""
