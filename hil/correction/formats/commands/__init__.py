"""The verbs of controllers' files: `hil export` and `hil import`."""
