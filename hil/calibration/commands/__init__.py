"""The commands `hil calibrate` and `hil verify`."""
