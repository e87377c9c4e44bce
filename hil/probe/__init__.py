"""A touch probe's run-out (system D): formulas, machine file, procedure and its faces."""
