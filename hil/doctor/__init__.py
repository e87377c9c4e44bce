"""Preflight of an axis: drive, limits, instrument, and units and speed against the axis file."""
