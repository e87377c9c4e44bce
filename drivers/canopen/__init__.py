"""CANopen drives: CiA-301 communication and CiA-402 on python-can, with the object dictionaries of makers' files.

From the wire up:

    bus             frames by identifier on any python-can interface, dispatched by the waiting caller: no receiver thread
    adapters        opening an adapter                   wire_time       what frames and transfers cost
    sdo_transfer    SDO as generators, no I/O            sdo             the guarded client of one node
    abort_codes     what a refused transfer means        beside          the canopen package next to a drive
    cia301          objects of communication, named      identity        what a node says it is
    eds             dictionaries of vendors              eds_text        puts their text right
    dcf             device configurations, also concise  scan            which nodes are on the bus
    pdo             PDOs as data                         pdo_lint        what is wrong with a set before it is written
    pdo_setup       one node's PDOs, and back            whole_pdo       one PDO read and written as a single parameter
    node            SDO, heartbeat, emergencies, NMT     sync            who sends SYNC
    sampling        fresh values by SYNC                 connection      what is set up while connected
    stopping        sampling, stopping, power off        settings        times, supervision, homing
    stream          cyclic set-points to several drives  stream_axis     one of them
    touch_probe     positions latched by the drive       drive           all of that as a ServoDrive
    known_objects   which objects are parameters         not_parameters  which of them may not be written
    raw_parameters  parameters as bytes over SDO         side_by_side    several nodes' transfers at once
    table_map       a drive's own correction table       correction_table  reading and writing it

The standard CiA 402 itself is in `drivers.cia402`, access to parameters by name in `drivers.named_parameters`.

Nothing of this uses the canopen package; hil/decisions/0035-canopen-beside-not-below.md says why. It works beside a drive that hil
moves, and a network of it may be the bus (`beside`).
"""
