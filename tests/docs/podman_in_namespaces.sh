#!/bin/sh
# Stands in for podman: each container is a network namespace on one bridge, and runs its command.
# $PREFIX begins the names of the namespaces, $CONTAINERS is a folder for process ids and logs.
set -eu

namespace_of() {
    echo "$PREFIX$1"
}

make() { # NAME ADDRESS
    space=$(namespace_of "$1")
    ip netns add "$space"
    ip -n "$space" link set lo up
    ip -n "$space" link add eth0 type veth peer name "$1" netns "${PREFIX}hub"
    ip -n "${PREFIX}hub" link set "$1" master switch up
    ip -n "$space" address add "$2/24" dev eth0
    ip -n "$space" link set eth0 up
}

remove() { # NAME
    if [ -f "$CONTAINERS/$1.pid" ]; then
        kill -KILL "$(cat "$CONTAINERS/$1.pid")" 2>/dev/null || true
        rm "$CONTAINERS/$1.pid"
    fi
    ip netns delete "$(namespace_of "$1")" 2>/dev/null || true
}

verb=$1
shift
case $verb in
network)
    if [ "$1" = create ]; then
        ip netns add "${PREFIX}hub"
        ip -n "${PREFIX}hub" link add name switch type bridge
        ip -n "${PREFIX}hub" link set switch up
    else
        ip netns delete "${PREFIX}hub"
    fi
    ;;
run)
    name=once
    is_detached=
    while :; do
        case $1 in
        -d) is_detached=yes ;;
        --rm) ;;
        --name) name=$2; shift ;;
        --network) shift ;;
        --ip) address=$2; shift ;;
        *) break ;;
        esac
        shift
    done
    shift # the image
    make "$name" "$address"
    if [ -n "$is_detached" ]; then
        HOME=$CONTAINERS/$name
        export HOME
        mkdir -p "$HOME"
        setsid ip netns exec "$(namespace_of "$name")" "$@" >"$CONTAINERS/$name.log" 2>&1 &
        echo $! >"$CONTAINERS/$name.pid"
        exit 0
    fi
    code=0
    ip netns exec "$(namespace_of "$name")" "$@" || code=$?
    remove "$name"
    exit $code
    ;;
kill)
    kill -KILL "$(cat "$CONTAINERS/$1.pid")"
    ;;
rm)
    shift # -f
    for name in "$@"; do
        remove "$name"
    done
    ;;
*)
    echo "$verb is not known here" >&2
    exit 125
    ;;
esac
