"""The circle test of two axes: lost motion at the quadrants."""
