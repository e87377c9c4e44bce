"""Preflight of an axis: is everything there, and are units and speed what the axis file says?"""
