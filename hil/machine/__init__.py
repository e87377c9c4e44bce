"""The machine while anything of it may move: its axes watched together, its motions, and how it is left.

`supervisor` moves and stops; `watched_axis` is one look at an axis; `agreement` and `overspeed` judge what is seen; `time_out` says
why a motion is not over. Nothing here knows a concrete drive, an axis file or what is measured.
"""
