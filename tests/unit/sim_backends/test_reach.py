"""A simulated part is heard beyond this machine only when somebody says so."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.errors import InputError
from sim_backends.reach import check_can, parse_tcp


@pytest.mark.parametrize("interface", ["udp_multicast", "socketcand", "pcan", "slcan", "ixxat"])
def test_an_interface_that_leaves_the_machine_needs_permission(interface: str) -> None:
    with pytest.raises(InputError, match="--allow-outside"):
        check_can(interface, "x", allow_outside=False)
    check_can(interface, "x", allow_outside=True)


def test_a_virtual_bus_ends_at_the_process_and_is_refused_always() -> None:
    with pytest.raises(InputError, match="this process only"):
        check_can("virtual", "x", allow_outside=True)


def test_a_vcan_is_told_from_hardware_by_where_the_kernel_keeps_it(tmp_path: Path) -> None:
    hardware = tmp_path / "pci0000:00" / "can0"
    hardware.mkdir(parents=True)
    (tmp_path / "can0").symlink_to(hardware)
    with pytest.raises(InputError, match="can0 is real hardware"):
        check_can("socketcan", "can0", allow_outside=False, devices=tmp_path)
    check_can("socketcan", "can0", allow_outside=True, devices=tmp_path)
    (tmp_path / "lo").symlink_to("/sys/devices/virtual/net/lo")
    check_can("socketcan", "lo", allow_outside=False, devices=tmp_path)
    check_can("socketcan", "vcan9", allow_outside=False, devices=tmp_path)  # not there: opening it says so
    check_can("slcan-pty", "", allow_outside=False)


def test_only_loopback_addresses_are_served() -> None:
    assert parse_tcp("127.0.0.1:0", allow_outside=False) == ("127.0.0.1", 0)
    assert parse_tcp("localhost:5020", allow_outside=False) == ("127.0.0.1", 5020)
    assert parse_tcp("127.3.2.1:1", allow_outside=False) == ("127.3.2.1", 1)
    for address in ("0.0.0.0:502", "192.168.0.1:502", "10.0.0.1:0"):
        with pytest.raises(InputError, match="from outside"):
            parse_tcp(address, allow_outside=False)
        assert parse_tcp(address, allow_outside=True)[0] == address.split(":")[0]


@pytest.mark.parametrize(
    "address", ["", "127.0.0.1", ":", "127.0.0.1:", "127.0.0.1:65536", "127.0.0.1:-1", "host:1", ":5"]
)
def test_what_is_no_address_is_named(address: str) -> None:
    with pytest.raises(InputError, match="address"):
        parse_tcp(address, allow_outside=False)
