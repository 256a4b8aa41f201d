#!/bin/sh
# Two Raspberry Pis and a laptop as network namespaces on one Ethernet, to try the commands of
# docs/field.md on one machine. As root:
#
#   sh examples/two_pis.sh up          # makes them: laptop 10.77.0.1, tb3-01 10.77.0.2, tb3-02 10.77.0.3
#   sh examples/two_pis.sh on tb3-01 COMMAND...
#   sh examples/two_pis.sh down
#
# $PREFIX (two-pis-) is what the names of the namespaces begin with.
set -eu
prefix=${PREFIX:-two-pis-}

case ${1:-} in
up)
    ip netns add "${prefix}hub"
    ip -n "${prefix}hub" link add name radio type bridge
    ip -n "${prefix}hub" link set radio up
    number=0
    for host in laptop tb3-01 tb3-02; do
        number=$((number + 1))
        ip netns add "$prefix$host"
        ip -n "$prefix$host" link set lo up
        ip -n "$prefix$host" link add eth0 type veth peer name "$host" netns "${prefix}hub"
        ip -n "${prefix}hub" link set "$host" master radio up
        ip -n "$prefix$host" address add "10.77.0.$number/24" dev eth0
        ip -n "$prefix$host" link set eth0 up
    done
    ;;
on)
    host=$2
    shift 2
    exec ip netns exec "$prefix$host" "$@"
    ;;
down)
    for host in laptop tb3-01 tb3-02 hub; do
        ip netns delete "$prefix$host" 2>/dev/null || true
    done
    ;;
*)
    echo "usage: sh $0 up | on HOST COMMAND... | down" >&2
    exit 2
    ;;
esac
