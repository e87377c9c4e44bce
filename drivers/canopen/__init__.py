"""CANopen drives: CiA-301 communication and CiA-402 on python-can, with object dictionaries read by the canopen package.

What may go in: one module per concern. From the wire up:

    bus           frames by identifier on any python-can interface, pumped by whoever waits: no receiver thread
    sdo_transfer  SDO as generators, no I/O              sdo         the guarded client, several nodes at once
    objects       standard objects, named                eds         dictionaries of vendors (eds_text puts their text right)
    pdo           PDOs as data, written and verified     pdo_lint    what is wrong with a set before it is written
    pdo_setup     one node's PDOs, and back              wire_time   what frames cost
    node          SDO, heartbeat, emergencies, NMT       scan        who is on the bus
    cia402        the power state machine as tables      power       walking it
    sampling      fresh values by SYNC                   motion      profile moves, set-point handshake, modes
    connection    what is set up while connected         settings    times, supervision, homing
    stopping      looked at, stopped, without power      stream      cyclic set-points to several drives (stream_axis: one of them)
    touch_probe   positions latched by the drive         parameters  access by dictionary (named_parameters, raw_parameters)
    units         what a drive says of its units         drive       all of that as a ServoDrive
    dcf           device configurations, also concise    lss         nodes without an id
    sdo_cost      what transfers cost on the bus

The canopen package's SDO client and CiA-402 node are not used: their faults (tests/integration/test_canopen_library_faults.py) lie
in what a wrapper cannot reach - a reply taken without its index, a mode change that sends a controlword nobody gave - and they
need a receiver thread, which loses exceptions and makes simulated time impossible.
"""
