"""hil: measure a feed axis, correct it, prove it, and trace what is left to the effect the model lacks."""
