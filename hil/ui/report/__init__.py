"""Blocks, drawings and data that reports are made of, as a page and on paper."""
