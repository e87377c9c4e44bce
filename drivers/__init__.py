"""Drivers for real devices: servo drives, instruments, sensors.

The loose modules hold what the rest of the project works against (`drive`, `limits`, `instrument`) and what the wires share (`errors`,
`clock`, `scaling`, `toml_types`, `toml_schema`); each wire has a folder of its own. No module here imports `hil` or `sim_backends`.
"""
