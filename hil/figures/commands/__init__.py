"""The verb of figures: `hil iso230`."""
