"""Correction: tables, the engine that applies them, the bound, the sealed store, and controllers' files."""

TABLES = ("pitch", "backlash", "specified", "straightness")
"""The tables that may have a password of their own."""
