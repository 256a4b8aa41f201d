"""The signal of stations, from the output of `iw` and the kernel's table of neighbours."""

from __future__ import annotations

from swarmd.daemon.neighbors import parse_arp, parse_stations

STATIONS = """Station dc:a6:32:00:00:02 (on wlan0)
\tinactive time:\t40 ms
\trx bytes:\t12345
\tsignal:  \t-61 [-63, -66] dBm
\tsignal avg:\t-60 dBm
Station dc:a6:32:00:00:03 (on wlan0)
\tinactive time:\t12000 ms
Station dc:a6:32:00:00:04 (on wlan0)
\tsignal avg:\t-81 dBm
"""
ARP = """IP address       HW type     Flags       HW address            Mask     Device
10.0.0.2         0x1         0x2         dc:a6:32:00:00:02     *        wlan0
10.0.0.9         0x1         0x0         00:00:00:00:00:00     *        wlan0
"""


def test_each_station_has_its_own_signal_or_none() -> None:
    assert parse_stations(STATIONS) == {
        "dc:a6:32:00:00:02": -61.0,
        "dc:a6:32:00:00:04": -81.0,
    }
    assert parse_stations("") == {}


def test_addresses_that_the_kernel_has_not_resolved_are_left_out() -> None:
    assert parse_arp(ARP) == {"dc:a6:32:00:00:02": "10.0.0.2"}
    assert parse_arp("") == {}
