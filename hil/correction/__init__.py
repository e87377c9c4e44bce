"""Correction: tables, the engine that applies them, the bound, the sealed store, and controllers' files."""
