#!/bin/sh
# Installs swarmd @VERSION@ from this folder, without a network: sudo ./install.sh
# --prefix DIR   where to [/opt/swarmd]
# --python FILE  the Python to use [the newest of the system that will do, else that of the archive]
# --no-links     without swarmd and swarmctl in /usr/local/bin
# Each version has a folder of its own, to which <prefix>/current leads once it is complete.
set -eu
version=@VERSION@ machine=@MACHINE@ pythons="@PYTHONS@"
prefix=/opt/swarmd python='' links=yes
die() { echo "install.sh: $*" >&2; exit 1; }

while [ $# -gt 0 ]; do
    case $1 in --prefix | --python) [ $# -ge 2 ] || die "$1 needs a value" ;; esac
    case $1 in
        --prefix) prefix=$2; shift 2 ;;
        --python) python=$2; shift 2 ;;
        --no-links) links=no; shift ;;
        -h | --help) sed -n '2,6s/^# //p' "$0"; exit 0 ;;
        *) die "unknown option $1 (see --help)" ;;
    esac
done
case $prefix in /*) ;; *) prefix=$PWD/$prefix ;; esac
cd "$(dirname "$0")"

# The packages count, not the kernel: Raspberry Pi OS of 32 bits runs on a kernel of 64.
here=$(uname -m)
if command -v dpkg >/dev/null; then
    here=$(dpkg --print-architecture)
    case $here in amd64) here=x86_64 ;; arm64) here=aarch64 ;; esac
fi
[ "$here" = "$machine" ] || die "this archive is for $machine, and this system is $here"
sha256sum --check --quiet SHA256SUMS >&2 || die "the archive is damaged; copy it again"
{ mkdir -p "$prefix" && [ -w "$prefix" ]; } 2>/dev/null || die "$prefix cannot be written; use sudo"

name=$version-$(sha256sum SHA256SUMS | cut -c 1-8)
before=$(readlink "$prefix/current" || true)
[ "$before" != "$name" ] || { echo "swarmd $version is installed in $prefix already"; exit 0; }
new=$prefix/$name
trap 'rm -rf "$new"' EXIT
trap 'exit 1' HUP INT TERM
rm -rf "$new" && mkdir "$new"

# Whether there are wheels for it, and it can make environments.
is_usable() {
    found=$("$1" -c 'import sys, venv, zlib; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) || return 1
    case " $pythons " in *" $found "*) ;; *) return 1 ;; esac
}
if [ -n "$python" ]; then
    is_usable "$python" || die "$python cannot be used; wanted Python $pythons with venv"
else
    for one in $(for v in $pythons; do echo "python$v"; done | sort -r) python3; do
        if is_usable "$one"; then python=$(command -v "$one"); break; fi
    done
fi
if [ -z "$python" ]; then
    [ -e python.tar.gz ] || die "no Python $pythons here, and the archive holds no Python; give --python"
    tar -xzf python.tar.gz --no-same-owner -C "$new"
    python=$(ls "$new"/python/bin/python3.1[0-9])
    is_usable "$python" || die "the archive's Python does not run here: $("$python" -c 'import venv, zlib' 2>&1 | tail -n 1)"
fi
echo "Python: $python ($("$python" -V 2>&1))"

# pip from its wheel: Debian and Ubuntu ship Python without it.
"$python" -m venv --without-pip "$new/venv"
"$new/venv/bin/python" "$(ls wheels/pip-*.whl)/pip" --disable-pip-version-check install --quiet \
    --no-index --find-links wheels --no-cache-dir --root-user-action ignore \
    "$(ls wheels/swarmd-*.whl)[@EXTRAS@]"
"$new/venv/bin/swarmd" --version
kernels=$("$new/venv/bin/python" -c 'from swarmd.core.kernels import describe_kernels as d; print(d())')
echo "kernels: $kernels"

switch() { ln -sfn "$1" "$2.partial" && mv -T "$2.partial" "$2"; } # at once, or not at all
switch "$name" "$prefix/current"
switch current/venv/bin "$prefix/bin"
trap - EXIT
for old in "$prefix"/[0-9]*-????????; do
    case $old in "$new" | "$prefix/${before:-$name}") ;; *) rm -rf "$old" ;; esac
done
if [ $links = yes ]; then
    for program in swarmd swarmctl; do switch "$prefix/bin/$program" "/usr/local/bin/$program"; done
fi
echo "installed in $new${before:+; before: $prefix/$before}"
echo "next: sudo swarmd install BUNDLE && sudo swarmd service install"
