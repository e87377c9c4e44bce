"""Whole sets of drive parameters: backed up, compared, written all or nothing, proven, kept.

    set_file     a set as a TOML file          dcf      the same as DCF or concise DCF
    preflight    may it be written at all      order    what first
    transaction  write, prove, or put back     journal  what a power cut leaves to go on from
    several      many drives at a time         predict  what it costs on the wire

The core works against `drivers.raw_parameters` alone, so that it is the same on every wire.
"""
