"""The session at a machine: axes that are moved, watched and stopped together, and the rows that are measured on them.

supervisor     moves the axes, watches them, stops them     watched_axis     one look at a drive and its instrument
instrument_check  instrument against motor                  time_out         likely reason of a motion that times out
motion_checks  motor against travel, rest and commanded speed    drive_setting    a number that a drive keeps, by name
session        drive, instrument and correction together    set_points       command for a target
measure        a pass of steps, and after a lost beam       dwell            averaging at a target
interrupts     SIGINT, SIGTERM, SIGHUP                      wiring           axis file -> session (one axis)
machine        a connected axis                   axes_wiring  the same for several axes
links          a machine's links, shared by its drives
canopen_wiring, modbus_wiring, bench_wiring      drives of each wire, and the bench; loaded when an axis file names them
"""
