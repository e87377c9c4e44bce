"""Example scripts, one per system; each can be run: `python -m hil.examples.commission AXIS.toml`."""
