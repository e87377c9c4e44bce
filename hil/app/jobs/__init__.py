"""What a job is, once, for the command line and for the screen.

What may go in: one module per job that composes procedures with the axis file, the campaign, the store and the report; functions of a
connected axis and a listener that return what came of it. No arguments to parse, nothing printed, nothing drawn.
"""
