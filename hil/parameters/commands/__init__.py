"""The verbs of `hil params`."""
