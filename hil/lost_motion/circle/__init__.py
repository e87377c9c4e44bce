"""The circle of two axes: what lost motion does at the quadrants."""
