"""What keeps a real base safe beside its driver: the stopper, ROS 1's adapter, recordings.

A textual change for each that the tests must notice.
"""

from __future__ import annotations

from benchmarks.mutations import mutants_of

_STOPPER_TESTS = "tests/driving/test_stopper.py"
_GUARDED_TESTS = "tests/driving/test_guarded.py"

_STOPPER = (
    *mutants_of(
        "swarmd/driving/stopper.py",
        _STOPPER_TESTS,
        ("stopper: silence", "0.5 s", "SILENCE = 0.4", "SILENCE = 0.5"),
        ("stopper: bound of silence", "after it", ">= SILENCE)", "> SILENCE)"),
        ("stopper: zeros at least", "1.9 s", "AT_LEAST = 2.0", "AT_LEAST = 1.9"),
        ("stopper: a guardian that is back at once", "zeros end with it",
         "and not is_wanted and now - self._began >= AT_LEAST:", "and not is_wanted:"),
        ("stopper: before the first tick", "it says zero",
         "        if self._heard is None:\n            return False",
         "        if self._heard is None:\n            self._heard = now - 1.0"),
        ("stopper: farewell to one that drove", "there are no zeros",
         "if self._began is None and self._heard is not None and not self._may_end:", "if False:"),
        ("stopper: relief", "its zeros go on", "self._may_end = True", "pass"),
        ("stopper: one that thaws", "it stays relieved",
         "        self._heard = now\n        self._may_end = False", "        self._heard = now"),
        ("stopper: when it is done", "once it is relieved",
         "return self._may_end and not self.is_sending(now)", "return self._may_end"),
    ),
    *mutants_of(
        "swarmd/driving/stopper.py",
        _GUARDED_TESTS,
        ("stopper: 20 zeros a second", "two a second", "self._next = now + PERIOD",
         "self._next = now + 10.0 * PERIOD"),
        ("stopper: a zero that fails", "it is the last", "except Exception as error:",
         "except ZeroDivisionError as error:"),
        ("stopper: farewell", "it is an end of file",
         "self._is_asked |= frame == FAREWELL", "pass"),
        ("stopper: its answers", "there are none",
         "tick(boottime())\n                self._answer(",
         "tick(boottime())\n                str("),
        ("stopper: one at work", "it is relieved too",
         "if self._deadman.is_silent(boottime()):", "if True:"),
    ),
    *mutants_of(
        "swarmd/driving/guarded.py",
        _GUARDED_TESTS,
        ("guardian: it feeds", "it does not", "            self._stopper.feed()\n", ""),
        ("guardian: first the stopper", "the driver does not wait for it",
         "            await stopper.start()\n            log", "            log"),
        ("guardian: stopper that is lost", "the driver goes on",
         "{living, losing}, return_when=asyncio.FIRST_COMPLETED", "{living}"),
        ("guardian: stopper that is mute", "it is lost after 2 s", "SILENT_AFTER = 1.0",
         "SILENT_AFTER = 2.0"),
        ("guardian: farewell", "it hangs up", "self._socket.send(FAREWELL)", "pass"),
    ),
    *mutants_of(
        "swarmd/driving/base.py",
        _STOPPER_TESTS,
        ("base: silent without a deadman", "it may be",
         'if found.idle_output == "silent" and found.deadman == "none":', "if False:"),
        ("base: deadman not told", "the base has one", '"base" if driver.is_simulated else "none"',
         '"base"'),
        ("base: silent is only who is idle", "also who is stopped",
         "if not (is_idle and twist.is_zero):", "if not twist.is_zero:"),
    ),
    *mutants_of(
        "swarmd/driving/making.py",
        _STOPPER_TESTS,
        ("base: silent and no deadman told", "it may be",
         'if base.idle_output == "silent":', "if False:"),
        ("base: driver without a stopper", "it runs", "if not isinstance(driver, Stopping):",
         "if not isinstance(driver, Stopping):\n        return wrapped\n    if False:"),
    ),
)  # fmt: skip
_WIRE_TEST = "tests/drivers/test_ros1_wire.py::test_bytes_are_little_endian"
_WIRE = mutants_of(
    "drivers/ros1_wire.py",
    f"{_WIRE_TEST}_and_fields_in_their_order",
    ("ros1: byte order", "it is that of networks", '_SCAN = struct.Struct("<7f")',
     '_SCAN = struct.Struct(">7f")'),
    ("ros1: padding", "numbers are aligned as in C", '_RANGE = struct.Struct("<B4f")',
     '_RANGE = struct.Struct("@B4f")'),
    ("ros1: sign of a command's turn", "it turns the other way", "0.0, 0.0, 0.0, twist.angular",
     "0.0, 0.0, 0.0, -twist.angular"),
    ("ros1: stamp", "seconds and nanoseconds are swapped", "Header(Time(seconds, nanoseconds)",
     "Header(Time(nanoseconds, seconds)"),
)  # fmt: skip
_ROS1 = (
    *mutants_of(
        "drivers/ros1_adapter.py",
        "tests/drivers/test_ros1_silence.py",
        ("adapter: silence", "0.6 s", "SILENCE = 0.4", "SILENCE = 0.6"),
        ("adapter: zeros after the end", "1 s", "STOPPING = 2.0", "STOPPING = 1.0"),
        ("adapter: commands that waited", "they are passed on", "_LATE = 0.2", "_LATE = 20.0"),
        ("adapter: one zero", "it makes silence harmless", "_ZEROED = 0.5", "_ZEROED = -1.0"),
        ("adapter: commands that move", "those that do not do", "if any(", "if not any("),
        ("adapter: who never drove", "it says zero", '= self._holds = bool(config["holds"])',
         '= True\n        self._holds = bool(config["holds"])'),
        ("adapter: what the one before left", "it is forgotten",
         '= self._holds = bool(config["holds"])', "= self._holds = False"),
        ("adapter: commands after the end", "they are passed on",
         "COMMAND_HEAD.size and self._ends_at is None:", "COMMAND_HEAD.size:"),
        ("adapter: base that connects", "it gets what comes next",
         "if publish_to is not None and self._publisher", "if False and self._publisher"),
    ),
    *mutants_of(
        "drivers/ros1_child.py",
        "tests/drivers/test_ros1_driving.py::test_of_what_waited_only_the_newest_of_each_link_is_news"
        "_and_nothing_old",
        ("ros1: newest only", "the oldest is delivered", "                newest[link] = frame",
         "                newest.setdefault(link, b'')\n                _ = frame"),
        ("ros1: messages that waited", "they are delivered", "OLD = 0.5", "OLD = 50.0"),
    ),
    *mutants_of(
        "drivers/ros1_options.py",
        "tests/drivers/test_ros1_driving.py::test_the_adapters_environment_is_that_of_the_options",
        ("ros1: ROS_HOSTNAME", "it stands beside ROS_IP", 'found.pop("ROS_HOSTNAME", None)',
         "pass"),
    ),
    *mutants_of(
        "drivers/ros1.py",
        "tests/drivers/test_ros1_driving.py",
        ("ros1: zero to a base that is back", "it gets what is wished",
         "            self._owes_zero = True\n            topic", "            topic"),
        ("ros1: what is missing", "it is not looked at", "self._end or self._view.missing(",
         "'' and self._view.missing("),
        ("ros1: zero of a new adapter", "it is not asked for", "drives and self._has_sent",
         "False"),
        ("ros1: turn of the lidar", "it is in radians", "math.radians(options.scan_yaw_deg)",
         "options.scan_yaw_deg"),
    ),
    *mutants_of(
        "drivers/ros1_view.py",
        "tests/drivers/test_ros1_driving.py",
        ("ros1: type", "any sum will do", "link.md5sum != sense.kind.md5sum", "False"),
        ("ros1: someone else", "he is not looked for",
         "if state.others and not self.options.shared_cmd_vel:", "if False:"),
        ("ros1: silent senses", "they are fresh for ever",
         "if sense.is_needed and not sense.is_fresh(now):", "if False:"),
        ("ros1: silence", "4 s", "SILENCE = 2.5", "SILENCE = 4.0"),
        ("ros1: base that does not listen", "it is driven", "if not state.connected:", "if False:"),
    ),
)  # fmt: skip
_REPLAY = (
    *mutants_of(
        "swarmd/driving/recording.py",
        "tests/drivers/test_replay.py::test_times_that_go_back_are_damage",
        ("recording: times that go back", "they are taken", "if entry.at < before:", "if False:"),
    ),
    *mutants_of(
        "swarmd/driving/recording.py",
        "tests/drivers/test_replay.py::test_what_is_no_recording_is_one_clear_line",
        ("recording: frames that are too long", "they are cut off", "if size > MAX_FRAME:",
         "if False:"),
    ),
    *mutants_of(
        "swarmd/driving/recording.py",
        "tests/drivers/test_replay.py::test_a_disk_that_is_full_ends_the_recording_and_nothing_else",
        ("recording: a disk that is full", "it ends the driver",
         "except OSError as error:\n            fault",
         "except ZeroDivisionError as error:\n            fault"),
    ),
    *mutants_of(
        "drivers/replay.py",
        "tests/drivers/test_replay.py::test_in_a_loop_stamps_and_sequences_go_on",
        ("replay: stamps in a loop", "they jump back", "scan.stamp + shift,", "scan.stamp,"),
        ("replay: sequences in a loop", "they jump back", "scan.seq + ahead,", "scan.seq,"),
    ),
    *mutants_of(
        "drivers/replay.py",
        "tests/drivers/test_replay.py::test_speed_makes_it_pass_faster",
        ("replay: speed", "it is slower by it", "entry.at / speed", "entry.at * speed"),
    ),
    *mutants_of(
        "drivers/replay.py",
        "tests/drivers/test_replay.py::test_each_beginning_is_commanded_zero_first_and_the_end_is"
        "_zero",
        ("replay: zero at each beginning", "only at the first",
         "self._is_up = self._owes_zero = True", "self._is_up = True"),
        ("replay: commands between two rounds", "they are taken",
         "if not self._is_up:\n            return", "if False:\n            return"),
        ("replay: zero at the end", "there is none", "                self._take(ZERO)",
         "                pass"),
    ),
)  # fmt: skip

MUTANTS = (*_STOPPER, *_WIRE, *_ROS1, *_REPLAY)
