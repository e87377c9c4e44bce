"""A drive is let go as it was found: every object that a whole job may write reads as before."""

from __future__ import annotations

import uuid

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive
from sim_backends.bench import Bench, BenchParameters
from sim_backends.canopen_drive import CanOpenSlave, served
from sim_backends.plant.parameters import geometric_axis


def image(slave: CanOpenSlave) -> dict[int, int]:
    """Objects that set a motion up, and those that set the communication up."""
    objects = (0x1017, 0x6060, 0x6065, 0x607F, 0x6081, 0x6083, 0x6084, 0x6085, 0x6098, 0x605A)
    return {index: slave.dictionary.number(index) for index in objects}


def test_a_whole_job_leaves_the_objects_as_they_were() -> None:
    parameters = BenchParameters(plant=geometric_axis(4))
    channel = uuid.uuid4().hex
    with Bench(parameters) as bench, served(bench.servo, bench.clock, channel=channel) as slave:
        before = image(slave)
        with CanLink.open(bench.clock, interface="virtual", channel=channel) as link:
            drive = CanOpenDrive("X", parameters.scaling, parameters.limits, bench.clock, link=link, node_id=1)
            with drive:
                drive.enable()
                drive.start_homing()
                drive.wait_for(lambda s: bool(s.homed) and s.target_reached, 60.0, "homing")
                drive.start_move(20.0, 50.0)
                drive.wait_for(lambda s: s.target_reached, 10.0, "move")
                assert image(slave) != before
        assert image(slave) == before
        assert not bench.servo.powered
