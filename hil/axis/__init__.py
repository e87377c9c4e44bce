"""The axis file: what a procedure may know about an axis, read once, checked, frozen."""

BENCH_MACHINES = ("ideal", "geometric", "bent", "typical", "worn")
"""Simulated axes of the bench: without error; pitch and backlash only; the same on a way that is not straight; with what a workshop
adds (heat, lost motion, screw cyclic); with a soft drive train that winds up by some 53 µm."""

BENCH_TABLES = ("simulated_array", "simulated_domain")
"""Correction tables that the bench's drive can hold itself; over Modbus it has that of its register map."""
