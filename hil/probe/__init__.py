"""A touch probe's run-out (system D, JPH08348B2): formulas, machine file, procedure, store, command, page and
report.
"""

MODES = ("latch", "step")
"""How a contact is found: by the drive's touch-probe function, or by pulses."""
