"""Calibration (system A): measuring passes, computing tables, proving and revising them, verifying, exploring."""
