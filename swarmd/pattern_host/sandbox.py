"""Denies this process the accesses that plugin code does not need: files, network, other processes.

Landlock (kernel documentation, userspace-api/landlock) permits reading the Python installation, the
import path and the folders that the daemon names, and permits no writing. A seccomp filter
(seccomp(2)) denies accesses that Landlock leaves open: sockets, signals to other processes,
tracing, namespaces, and changes of owners, modes and limits. A denied access raises
PermissionError. Both restrictions apply to all later threads and child processes, and cannot be
removed.
"""

from __future__ import annotations

import ctypes
import errno
import os
import struct
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path

import swarmd
from swarmd.core.messages import Sandbox
from swarmd.core.processes import keep_limits

FILES = "files"
NETWORK = "network"
PROCESSES = "processes"

_SYSTEM = (
    *("/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/opt", "/nix/store"),
    *("/etc/ld.so.cache", "/etc/localtime", "/etc/timezone", "/etc/passwd", "/etc/nsswitch.conf"),
    # Of /proc the own process alone: others have secrets in their command lines.
    *("/proc/self", "/proc/cpuinfo", "/proc/meminfo", "/proc/stat", "/proc/sys", "/proc/version"),
    *("/sys/devices/system", "/dev/urandom", "/dev/random", "/dev/zero"),
)

# Landlock. Its system calls have the same number on each architecture.
_CREATE_RULESET = 444
_ADD_RULE = 445
_RESTRICT_SELF = 446
_GET_VERSION = 1
_BENEATH = 1
_EXECUTE = 1 << 0
_WRITE_FILE = 1 << 1
_READ_FILE = 1 << 2
_READ_DIR = 1 << 3
_RIGHTS = {1: 13, 2: 14, 3: 15, 4: 15}
"""How many rights on files a version of Landlock knows; later ones 16."""

# seccomp
_MACHINES = {"x86_64": (0, 0xC000003E, 317), "aarch64": (1, 0xC00000B7, 277)}
"""Column of the tables below, AUDIT_ARCH, and the number of seccomp(2)."""
_DENIED = {
    "socket": (41, 198),
    # Access to other processes of this user
    "ptrace": (101, 117),
    "process_vm_readv": (310, 270),
    "process_vm_writev": (311, 271),
    "pidfd_getfd": (438, 438),
    "pidfd_send_signal": (424, 424),
    "process_madvise": (440, 440),
    "process_mrelease": (448, 448),
    "kcmp": (312, 272),
    "tkill": (200, 130),
    "rt_sigqueueinfo": (129, 138),
    "rt_tgsigqueueinfo": (297, 240),
    "setpriority": (141, 140),
    "ioprio_set": (251, 30),
    "sched_setscheduler": (144, 119),
    "sched_setparam": (142, 118),
    "sched_setattr": (314, 274),
    "sched_setaffinity": (203, 122),
    "migrate_pages": (256, 238),
    "move_pages": (279, 239),
    # Objects shared with other processes of this user; some are reached by their number alone.
    "shmget": (29, 194),
    "shmat": (30, 196),
    "shmctl": (31, 195),
    "msgget": (68, 186),
    "msgsnd": (69, 189),
    "msgrcv": (70, 188),
    "msgctl": (71, 187),
    "semget": (64, 190),
    "semop": (65, 193),
    "semctl": (66, 191),
    "semtimedop": (220, 192),
    "mq_open": (240, 180),
    "mq_unlink": (241, 181),
    "setrlimit": (160, 164),  # the daemon sets limits
    "setsid": (112, 157),  # the daemon ends the host's process group
    "setpgid": (109, 154),
    # Metadata of files
    "chmod": (90, None),
    "fchmod": (91, 52),
    "fchmodat": (268, 53),
    "fchmodat2": (452, 452),
    "chown": (92, None),
    "lchown": (94, None),
    "fchown": (93, 55),
    "fchownat": (260, 54),
    "truncate": (76, 45),
    "utime": (132, None),
    "utimes": (235, None),
    "futimesat": (261, None),
    "utimensat": (280, 88),
    "setxattr": (188, 5),
    "lsetxattr": (189, 6),
    "fsetxattr": (190, 7),
    "setxattrat": (463, 463),
    "removexattr": (197, 14),
    "lremovexattr": (198, 15),
    "fremovexattr": (199, 16),
    "removexattrat": (466, 466),
    "file_setattr": (469, 469),
    # Bypasses of this filter, and parts of the kernel that a pattern does not need
    "io_uring_setup": (425, 425),
    "io_uring_enter": (426, 426),
    "io_uring_register": (427, 427),
    "open_by_handle_at": (304, 265),
    "perf_event_open": (298, 241),
    "bpf": (321, 280),
    "userfaultfd": (323, 282),
    "inotify_init": (253, None),
    "inotify_init1": (294, 26),
    "fanotify_init": (300, 262),
    "syslog": (103, 116),
    "personality": (135, 92),
    "keyctl": (250, 219),
    "add_key": (248, 217),
    "request_key": (249, 218),
    "unshare": (272, 97),
    "setns": (308, 268),
    "open_tree_attr": (467, 467),
}
# The flags of these calls are in memory, which a filter cannot read. Without these calls libc uses
# clone and openat.
_ABSENT = {"clone3": (435, 435), "openat2": (437, 437)}
_NEWEST = 469
"""Number of the newest system call that the tables consider; x32 has greater ones, too."""
_KILL = (62, 129)
_TGKILL = (234, 131)
_PRLIMIT = (302, 261)
_CLONE = (56, 220)
_OPEN = (2, None)
_OPENAT = (257, 56)
# CLONE_NEWNS and the like; CLONE_PARENT, which makes a child of the daemon that nothing reaps
_NAMESPACES = 0x7E020000
_OF_PARENT = 0x8000
# of open: bits, and an access mode of 3
_TRUNCATE = os.O_TRUNC
_NEITHER = os.O_ACCMODE
_REFUSED_COMMANDS: tuple[tuple[tuple[int, int], int, tuple[int, ...]], ...] = (
    # prctl: PR_SET_PDEATHSIG, PR_SET_DUMPABLE (the daemon reads the size), PR_SCHED_CORE
    ((157, 167), 0, (1, 4, 62)),
    # fcntl: F_SETOWN and F_SETOWN_EX (the owner of a file gets the signals of its events),
    # F_SETLEASE (others wait when they open the file), F_NOTIFY
    ((72, 25), 1, (8, 15, 1024, 1026)),
    # ioctl: FIOSETOWN and SIOCSPGRP; TIOCSTI and TIOCLINUX (input of a terminal);
    # FS_IOC_SETFLAGS, FS_IOC_FSSETXATTR and FS_IOC_ENABLE_VERITY (of files that it only reads)
    ((16, 29), 1, (0x8901, 0x8902, 0x5412, 0x541C, 0x40086602, 0x401C5820, 0x40806685)),
)
"""Calls, the place of the command among their arguments, and the commands that are refused."""
_SOCKETPAIR = (53, 199)
_AF_UNIX = 1
_SOCK_STREAM = 1
_SOCK_SEQPACKET = 5
_SOCK_TYPE_MASK = 0xF
_PR_SET_NO_NEW_PRIVS = 38
_LOAD = 0x20  # codes of instructions
_EQUAL = 0x15
_AT_LEAST = 0x35
_ANY_BIT = 0x45
_AND = 0x54
_RETURN = 0x06
_NUMBER = 0  # places in struct seccomp_data
_ARCHITECTURE = 4
_ARGUMENTS = 16
_ALLOW = 0x7FFF0000  # verdicts
_REFUSE = 0x00050000 | errno.EPERM
_UNKNOWN = 0x00050000 | errno.ENOSYS
_SET_MODE_FILTER = 1
_ALL_THREADS = 1
_SPEC_ALLOW = 4
_CAPABILITY_VERSION = 0x20080522

_Instruction = tuple[int, int, int, int]


def confine(readable: Iterable[Path] = (), secret: Iterable[Path] = ()) -> Sandbox:
    """Confine this single-threaded process for ever; returns what the kernel now denies.

    `readable`: files and folders of plugins. `secret`: folders that stay unreadable, also below a
    folder of the import path or of `readable`.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    denied: list[str] = []
    missing: list[str] = []
    keep_limits()
    _drop_capabilities(libc)
    if libc.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0:
        return Sandbox(missing=f"no_new_privs: {_error()}")
    plugins = (path for granted in readable for path in _with_links(granted))
    if fault := _restrict_files(libc, {*_python_folders(), *plugins}, frozenset(secret)):
        missing.append(f"{FILES}: {fault}")
    else:
        denied.append(FILES)
    if fault := _restrict_system_calls(libc):
        missing.append(f"{NETWORK}, {PROCESSES}: {fault}")
    else:
        denied += [NETWORK, PROCESSES]
    return Sandbox(denied=tuple(denied), missing="; ".join(missing))


def _error() -> str:
    return os.strerror(ctypes.get_errno())


def _drop_capabilities(libc: ctypes.CDLL) -> None:
    """Drop the capabilities of a host whose daemon runs as root; else there are none."""
    header = struct.pack("=Ii", _CAPABILITY_VERSION, 0)
    libc.capset(header, bytes(24))


# Files


def _python_folders() -> Iterator[Path]:
    """The folders from which this interpreter imports, also those of editable installations."""
    yield from map(Path, (*_SYSTEM, sys.prefix, sys.base_prefix, sys.exec_prefix))
    libraries = os.environ.get("LD_LIBRARY_PATH", "").split(":")
    yield from (Path(entry) for entry in (*sys.path, *libraries) if entry)
    for folder in swarmd.__path__:
        yield from _with_links(Path(folder))
    for name, module in list(sys.modules.items()):
        if name.startswith("__editable___"):  # the finder of an editable installation (setuptools)
            yield from map(Path, getattr(module, "MAPPING", {}).values())


def _with_links(path: Path) -> Iterator[Path]:
    """The path, and the links inside if it is a folder: a rule applies to a link's target."""
    yield path
    with suppress(OSError):
        yield from (Path(entry) for entry in os.scandir(path) if entry.is_symlink())


def _real(path: Path) -> Path:
    """The path with all links resolved; unlike `Path.resolve`, a loop of links raises no error."""
    return Path(os.path.realpath(path))


def _without(path: Path, secret: frozenset[Path]) -> Iterator[tuple[Path, int]]:
    """(path, rights) for `path`, or for the parts of `path` that do not lie in `secret`."""
    if path in secret:
        return
    if not any(hidden.is_relative_to(path) for hidden in secret):
        yield path, _EXECUTE | _READ_FILE | _READ_DIR
        return
    yield path, _READ_DIR  # the import system lists the folder
    with suppress(OSError):
        for entry in path.iterdir():
            if not entry.is_symlink():
                yield from _without(entry, secret)


def _restrict_files(libc: ctypes.CDLL, readable: set[Path], secret: frozenset[Path]) -> str:
    """Apply Landlock; returns why it is not in force, empty if it is."""
    version = libc.syscall(_CREATE_RULESET, None, ctypes.c_size_t(0), _GET_VERSION)
    if version < 1:
        return f"no Landlock here: {_error()}"
    if len(os.listdir("/proc/self/task")) > 1:  # Landlock would not restrict other threads
        return "a library has started threads"
    handled = (1 << _RIGHTS.get(version, 16)) - 1  # all rights that this version knows
    ruleset = libc.syscall(_CREATE_RULESET, struct.pack("=Q", handled), ctypes.c_size_t(8), 0)
    if ruleset < 0:
        return f"Landlock: {_error()}"
    try:
        hidden = frozenset(map(_real, secret))
        for path in set(map(_real, readable)):
            for part, rights in _without(path, hidden):
                _allow(libc, ruleset, part, rights)
        _allow(libc, ruleset, Path("/dev/null"), _READ_FILE | _WRITE_FILE)
        if libc.syscall(_RESTRICT_SELF, ruleset, 0) != 0:
            return f"Landlock: {_error()}"
    finally:
        os.close(ruleset)
    return ""


def _allow(libc: ctypes.CDLL, ruleset: int, path: Path, rights: int) -> None:
    """Permit `rights` at a path and below it; an absent path is left out."""
    try:
        target = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:
        return
    try:
        if not os.path.isdir(path):
            rights &= ~_READ_DIR
        libc.syscall(_ADD_RULE, ruleset, _BENEATH, struct.pack("=Qi", rights, target), 0)
    finally:
        os.close(target)


# System calls


def _restrict_system_calls(libc: ctypes.CDLL) -> str:
    """Install the seccomp filter; returns why it is not in force, empty if it is."""
    machine = os.uname().machine
    if machine not in _MACHINES or sys.byteorder != "little" or sys.maxsize < 1 << 32:
        return f"no filter for processors of type {machine}"
    column, architecture, seccomp = _MACHINES[machine]
    program = b"".join(
        struct.pack("=HBBI", *instruction) for instruction in _program(column, architecture)
    )
    code = ctypes.create_string_buffer(program, len(program))
    filter_ = struct.pack("@HP", len(program) // 8, ctypes.addressof(code))
    # Without SPEC_ALLOW kernels before 5.16 slow the whole process against Spectre.
    flags = _ALL_THREADS | _SPEC_ALLOW
    if libc.syscall(seccomp, _SET_MODE_FILTER, flags, filter_) != 0:
        return f"seccomp: {_error()}"
    return ""


def _program(column: int, architecture: int) -> Iterator[_Instruction]:
    """The filter of system calls, in the classic BPF of seccomp(2).

    `architecture`: the AUDIT_ARCH of the processor. `column`: the index of this architecture in
    each pair of system call numbers.

    - An instruction is (code, jump if true, jump if false, operand). A jump is the number of
      instructions to skip.
    - `_if_called(n, block, verdict)` runs `block` for the system call n, then ends with `verdict`.
    - In a block `_argument(i)` loads argument i of the call.
    - If the loaded value is x, `_allowed(x)` permits the call, and `_refused(x)` refuses the call.
      `_required(x)` refuses the call if the loaded value is not x.
    """
    yield from _checked_architecture(architecture)
    # Calls that are refused (_DENIED), or seem absent (_ABSENT), whatever their arguments.
    for table, result in ((_DENIED, _REFUSE), (_ABSENT, _UNKNOWN)):
        for numbers in table.values():
            yield from _if_called(numbers[column], [], result)
    # kill and tgkill: refused, except for the own process.
    for numbers in (_KILL, _TGKILL):
        own_process = [*_argument(0), *_allowed(os.getpid())]
        yield from _if_called(numbers[column], own_process, _REFUSE)
    # prctl, fcntl and ioctl: permitted, except for the listed commands.
    for numbers, argument_index, commands in _REFUSED_COMMANDS:
        refusals = chain.from_iterable(map(_refused, commands))
        block = [*_argument(argument_index), *refusals]
        yield from _if_called(numbers[column], block, _ALLOW)
    yield from _if_called(_PRLIMIT[column], _reading_own_limits(), _REFUSE)
    # clone: permitted, except for new namespaces and for a child of the daemon. If none of these
    # flags is set, the jump by 1 skips the refusal.
    refused_flags = _NAMESPACES | _OF_PARENT
    clone = [*_argument(0), (_ANY_BIT, 0, 1, refused_flags), (_RETURN, 0, 0, _REFUSE)]
    yield from _if_called(_CLONE[column], clone, _ALLOW)
    # open and openat: permitted, except for modes that Landlock does not restrict.
    for numbers, argument_index in ((_OPEN, 1), (_OPENAT, 2)):
        yield from _if_called(numbers[column], _refused_modes(argument_index), _ALLOW)
    yield from _if_called(_SOCKETPAIR[column], _permitted_pairs(), _REFUSE)
    yield _RETURN, 0, 0, _ALLOW  # all other calls


def _checked_architecture(architecture: int) -> Iterator[_Instruction]:
    """Refuse the calls of another architecture (such as 32-bit calls), and load the call's number.

    System calls that are newer than the tables do not exist for the process.
    """
    yield _LOAD, 0, 0, _ARCHITECTURE
    yield _EQUAL, 1, 0, architecture
    yield _RETURN, 0, 0, _REFUSE
    yield _LOAD, 0, 0, _NUMBER
    yield _AT_LEAST, 0, 1, _NEWEST + 1
    yield _RETURN, 0, 0, _UNKNOWN


def _reading_own_limits() -> list[_Instruction]:
    """A block that permits prlimit only for the own process (pid 0), and only to read.

    A call reads if its third argument, the pointer to new limits, is NULL in both halves.
    """
    pid_0 = [*_argument(0), *_required(0)]
    return [*pid_0, *_argument(2), *_required(0), *_upper_half(2), *_allowed(0)]


def _refused_modes(argument_index: int) -> list[_Instruction]:
    """A block that refuses two modes of open that Landlock does not restrict.

    - The access mode 3, neither read nor write, which permits ioctl.
    - Reading with O_TRUNC, which empties the file: Landlock restricts this from Linux 6.2 on.
    """
    mode = [*_argument(argument_index), (_AND, 0, 0, _NEITHER | _TRUNCATE)]
    modes = (_NEITHER, _NEITHER | _TRUNCATE, _TRUNCATE)
    return [*mode, *chain.from_iterable(map(_refused, modes))]


def _permitted_pairs() -> list[_Instruction]:
    """A block that permits socket pairs of streams and packets.

    The sockets of a SOCK_DGRAM pair could be connected to other sockets.
    """
    family = [*_argument(0), *_required(_AF_UNIX)]
    kind = [*_argument(1), (_AND, 0, 0, _SOCK_TYPE_MASK)]
    return [*family, *kind, *_allowed(_SOCK_STREAM), *_allowed(_SOCK_SEQPACKET)]


def _if_called(
    number: int | None, block: Sequence[_Instruction], end: int
) -> Iterator[_Instruction]:
    """Instructions that run `block` if the system call `number` is called, then return `end`.

    `end`: the verdict (permit or refuse). None for `number`: the architecture lacks the call, so
    there is no instruction.
    """
    if number is not None:
        yield _EQUAL, 0, len(block) + 1, number
        yield from block
        yield _RETURN, 0, 0, end


def _argument(index: int) -> list[_Instruction]:
    """Load an argument of type int, or the lower half of a 64-bit argument."""
    return [(_LOAD, 0, 0, _ARGUMENTS + 8 * index)]


def _upper_half(index: int) -> list[_Instruction]:
    return [(_LOAD, 0, 0, _ARGUMENTS + 8 * index + 4)]


def _required(value: int) -> list[_Instruction]:
    return [(_EQUAL, 1, 0, value), (_RETURN, 0, 0, _REFUSE)]


def _allowed(value: int) -> list[_Instruction]:
    return [(_EQUAL, 0, 1, value), (_RETURN, 0, 0, _ALLOW)]


def _refused(value: int) -> list[_Instruction]:
    return [(_EQUAL, 0, 1, value), (_RETURN, 0, 0, _REFUSE)]
