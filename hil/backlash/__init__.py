"""Lost motion from the motor's torque through a reversal (system B, CN103561904).

procedure    the motion and its readings       trace             torque over travel of one reversal
torque_fit   the amount, by a fit              result            the amounts of all reversals, by the published rule too
measured     the same as a result for terminal, script and report
settings     where the drive keeps the amount  neutral_settings  its own compensation off, and as before afterwards
"""
