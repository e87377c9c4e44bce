"""The axis file: what a procedure may know about an axis, read once, checked, frozen."""
