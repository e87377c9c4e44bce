"""Scripts to start from, one per system. Each runs as it stands: `python -m hil.examples.commission AXIS.toml`."""
