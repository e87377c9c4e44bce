"""Machines whose causes are composed from a grammar, written apart from the diagnosis that they judge.

The generator (`campaign`, `environment`, `noise`, `physics`, `outside`, `machine`, `reference`) imports nothing of
the project. `judge` runs the public verbs on what it writes, `equivalence` says which of the catalogue's names are
right for which cause, `report` counts.
"""
