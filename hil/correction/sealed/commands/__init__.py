"""The verbs of sealed files: `hil seal`, `open`, `sign`, `check`."""
