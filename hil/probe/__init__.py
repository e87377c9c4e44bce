"""A touch probe's run-out (system D, JPH08348B2): formulas, machine file, procedure, store, command, page and
report.
"""
