"""Procedures: what is done at a machine, each written as its list of steps over the drive and instrument abstractions.

What may go in: steps, decisions, and the values they return. No argument parsing, no printing, no concrete drive or instrument;
progress goes out as events (`events`), so that a terminal and a screen can show the same procedure.
"""
