"""Ports and packet filters of this machine."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys

import pytest

from swarmd.link.carriers.network_facts import dropping_rules, measure_network, port_users

NFT = """
table inet filter {
	chain input {
		type filter hook input priority filter; policy drop;
		ct state established,related accept
		udp dport 7440 accept
		meta pkttype multicast drop
	}
	chain forward { type filter hook forward priority filter; policy accept; }
}
"""
IPTABLES = """
*filter
:INPUT DROP [0:0]
:FORWARD ACCEPT [0:0]
-A INPUT -p udp -m udp --dport 7446 -j REJECT --reject-with icmp-port-unreachable
-A INPUT -p tcp -m tcp --dport 22 -j ACCEPT
COMMIT
"""


def test_rules_that_drop_are_found() -> None:
    assert len(dropping_rules(NFT)) == 2
    assert len(dropping_rules(IPTABLES)) == 2
    assert dropping_rules(NFT.replace("drop", "accept")) == []


def test_rules_that_drop_groups_by_their_address_are_found() -> None:
    dropped = ("ip daddr 224.0.0.0/4 drop", "ip daddr 239.1.2.3 drop", "ip6 daddr ff00::/8 drop")
    assert dropping_rules("\n".join(dropped)) == list(dropped)
    kept = ("ip daddr 10.224.0.1 drop", "ether daddr ff:ff:ff:ff:ff:ff drop")
    assert dropping_rules("\n".join(kept)) == []


def test_a_port_names_its_user() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp, socket.socket() as tcp:
        udp.bind(("127.0.0.1", 0))
        tcp.bind(("127.0.0.1", 0))
        number = tcp.getsockname()[1]
        assert port_users("tcp", number).users == ()
        tcp.listen()
        assert port_users("tcp", number).users == ("this process",)
        assert port_users("udp", udp.getsockname()[1]).users == ("this process",)


@pytest.mark.integration
def test_the_facts_of_an_interface() -> None:
    facts = measure_network("lo")
    assert (facts.exists, facts.mtu is not None) == (True, True)
    assert facts.firewall in ("open", "drops", "unknown")
    assert not measure_network("absent0").exists


@pytest.mark.integration
@pytest.mark.skipif(
    os.geteuid() != 0 or not shutil.which("nft") or not shutil.which("unshare"),
    reason="needs root, nft and unshare",
)
def test_a_rule_of_nft_that_drops_is_told() -> None:
    code = (
        "nft add table inet t; nft 'add chain inet t c { type filter hook input priority 0; }';"
        ' nft add rule inet t c udp dport 7446 drop; exec "$@"'
    )
    program = (
        "from swarmd.link.carriers.network_facts import measure_network as m;"
        "print(m('lo').firewall)"
    )
    done = subprocess.run(
        ["unshare", "-n", "sh", "-c", code, "sh", sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=False,
    )
    if "Operation not supported" in done.stderr or "not permitted" in done.stderr:
        pytest.skip("the kernel offers no nftables here")
    assert done.stdout.strip() == "drops", done.stderr
