"""Calibration (system A): measure passes, compute tables, prove them, revise; verify; explore."""
