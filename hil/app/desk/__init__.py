"""The operator's desk: everything that a screen does and that is not drawing.

What may go in: who holds control, which role he has, the one thread that owns an axis, what is shown of it, and what was left
unfinished. Everything here can be tested in simulated time without a browser.
"""
