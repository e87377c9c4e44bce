"""Figures computed from rows (ISO 230-2, uncertainty, latency, alignment of the beam) and their history over months."""
