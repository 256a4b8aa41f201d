"""The unit that runs the daemon as a service of systemd, and the account that it runs under."""

from __future__ import annotations

from pathlib import Path

SERVICE = "swarmd"
UNIT_FILE = Path("/etc/systemd/system/swarmd.service")
SYSUSERS_FILE = Path("/etc/sysusers.d/swarmd.conf")
CONFIG_FOLDER = Path("/etc/swarmd")
CONFIG_FILE = CONFIG_FOLDER / "swarmd.yaml"
STATE_FOLDER = Path("/var/lib/swarmd")
USER = "swarmd"
SERIAL_GROUP = "dialout"
"""Debian's and Ubuntu's group of serial devices."""

SYSUSERS = f"""# Written by `swarmd service install`.
u {USER} - "swarmd, the daemon of a robot" {STATE_FOLDER}
m {USER} {SERIAL_GROUP}
"""

_CONFINING = ("landlock_create_ruleset", "landlock_add_rule", "landlock_restrict_self", "seccomp")

_UNIT = """# Written by `swarmd service install`. To change a line, run: systemctl edit swarmd
[Unit]
Description=swarmd, the daemon of a robot
After=network.target
ConditionPathExists={config}
# Gives up after 60 failed starts within 10 minutes.
StartLimitIntervalSec=600
StartLimitBurst=60

[Service]
Type=notify
NotifyAccess=main
ExecStart={program} --config {config}
# Zero once more, over a connection of its own, however the daemon ended.
ExecStopPost=-{program} stop-base --config {config}
# The daemon feeds this watchdog twice a second, as long as protection decides.
WatchdogSec=5
TimeoutStartSec=60
TimeoutStopSec=10
Restart=on-failure
RestartSec=5
# 2: wrong settings; 5: the driver cannot be used on this machine.
RestartPreventExitStatus=2 5
# A pattern host that takes too much memory ends alone.
OOMPolicy=continue

User={user}
Group={user}
StateDirectory=swarmd
StateDirectoryMode=0750
ConfigurationDirectory=swarmd
# New rosters of the swarm are written there.
ReadWritePaths=-{config_folder}/identities
UMask=0027
# What the daemon was doing when the watchdog ended it.
Environment=PYTHONFAULTHANDLER=1

NoNewPrivileges=yes
CapabilityBoundingSet=
AmbientCapabilities=
ProtectSystem=strict
# Patterns and settings may lie in a home.
ProtectHome=read-only
PrivateTmp=yes
PrivateMounts=yes
ProtectProc=invisible
ProtectClock=yes
ProtectHostname=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
ProtectControlGroups=yes
KeyringMode=private
LockPersonality=yes
MemoryDenyWriteExecute=yes
RestrictNamespaces=yes
RestrictRealtime=yes
RestrictSUIDSGID=yes
RemoveIPC=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK
SystemCallArchitectures=native
# The last four confine pattern hosts.
SystemCallFilter=@system-service {confining}
SystemCallFilter=~@privileged
SystemCallErrorNumber=EPERM
# Serial devices; all of type char, since a device that is plugged in later may get a new number.
DevicePolicy=closed
DeviceAllow=char-* rw

[Install]
WantedBy=multi-user.target
"""


def unit_text(program: Path, config: Path = CONFIG_FILE) -> str:
    """The text of the unit. `program`: the absolute path of `swarmd` on the robot."""
    return _UNIT.format(
        program=_quoted(program),
        config=_quoted(config),
        user=USER,
        confining=" ".join(_CONFINING),
        config_folder=CONFIG_FOLDER,
    )


def _quoted(path: Path) -> str:
    """The path as systemd reads it: a `%` begins a specifier, a space ends a word."""
    text = str(path).replace("%", "%%")
    return f'"{text}"' if " " in text else text
