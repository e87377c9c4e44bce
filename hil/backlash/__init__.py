"""Lost motion from the motor's torque through a reversal: what was recorded, and what can be read from it.

What may go in: pure functions of recorded torque and travel. Steps, drives and files are others' work.
"""
