"""The loop at the machine: calibrate, explore, diagnose, add the missing effect, explore again."""
