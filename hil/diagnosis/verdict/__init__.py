"""The verdict: which results of the search are significant, the remaining rivals, and an optional correction without a
cause.
"""
