"""Drivers talk to real things: servo drives, instruments, sensors.

What may go in: the abstractions the rest of the project works against (`drive`, `instrument`), what they share
(`errors`, `clock`, `scaling`, `toml_types`, `toml_schema`), and one folder per wire. Nothing here knows of `hil` or of `sim_backends`.
"""
