"""A canopen.Network of yours is the bus: hil moves the axis on it, and you read objects meanwhile."""

import sys

import canopen

from hil.axis.axis_file import load_drive_axis
from hil.machine.wiring import connected_drive

axis = load_drive_axis(sys.argv[1])
with canopen.Network() as network:
    network.connect(interface=axis.drive.interface, channel=axis.drive.channel)
    node = network.add_node(axis.drive.node_id, sys.argv[2])
    with connected_drive(axis, network=network) as drive:
        drive.enable()
        drive.start_move(10.0, 50.0)
        while not drive.sample().target_reached:
            print(node.sdo["Position actual value"].raw, node.sdo["Statusword"].bits[2])
