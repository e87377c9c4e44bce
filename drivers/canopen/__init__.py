"""CANopen drives: CiA-301 communication and CiA-402 on python-can, with the object dictionaries of makers' files.

From the wire up:

    bus           frames by identifier on any python-can interface, dispatched by the waiting caller: no receiver thread
    sdo_transfer  SDO as generators, no I/O              sdo         the guarded client, several nodes at once
    objects       standard objects, named                eds         dictionaries of vendors (eds_text puts their text right)
    pdo           PDOs as data, written and verified     pdo_lint    what is wrong with a set before it is written
    pdo_setup     one node's PDOs, and back              wire_time   what frames cost
    node          SDO, heartbeat, emergencies, NMT       scan        which nodes are on the bus
    cia402        the power state machine as tables      power       walking it
    sampling      fresh values by SYNC                   motion      profile moves, set-point handshake, modes
    connection    what is set up while connected         settings    times, supervision, homing
    stopping      sampling, stopping, taking power off   stream      cyclic set-points to several drives (stream_axis: one of them)
    touch_probe   positions latched by the drive         parameters  access by dictionary (named_parameters, raw_parameters)
    units         the units that a drive reports         drive       all of that as a ServoDrive
    dcf           device configurations, also concise    sdo_cost    what transfers cost on the bus
    not_parameters  targets, commands, volatile objects  whole_pdo   one PDO as a single parameter
    beside        the canopen package's network and node next to a drive

Nothing of this uses the canopen package; hil/decisions/0035-canopen-beside-not-below.md says why. It works beside a drive that hil
moves, and a network of it may be the bus (`beside`).
"""
