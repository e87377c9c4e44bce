"""The operator's desk: the screen's logic without drawing, which runs in simulated time without a browser in tests.

desk         jobs and state of one axis            axis_thread  the thread that owns the axis
job          a job and its place of work           plan         what it moves and writes
control      which browser may give commands       roles        operator or builder
live         the state shown of an axis            progress     the state shown of a job
stop         the operator's stop, its distance     unfinished   interrupted work in the axis's folder
asking       a job's questions to the operator     event_log    what happened at an axis
rows         readings and rows for scripts         error_log    program errors
worker_process, worker_program  computations in a process of their own
"""
