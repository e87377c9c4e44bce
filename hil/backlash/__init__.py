"""Lost motion from the motor's torque through a reversal (system B, CN103561904): measuring, evaluating, writing to the
drive.
"""
