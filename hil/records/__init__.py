"""Measurement records: rows, the journal that writes them as they are measured, the chain that proves them unchanged,
and the axis's zero.
"""
