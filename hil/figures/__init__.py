"""Figures: pure numbers from rows (ISO 230-2, uncertainty, latency, the beam's alignment) and their history over months."""
