"""Lost motion after a reversal as two smooth terms: the published form, the form that runs, and the fit.

What may go in: pure functions and frozen values of travel and amounts. Set-points, drives and files are others' work.
"""
