"""The verb of a bus: `hil scan`."""
