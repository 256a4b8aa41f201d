"""Which worker of pytest-xdist runs which test file: files that wait beside files that compute."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController

NICENESS = 5
"""Of a worker that computes: it leaves the processor to the daemons of the others."""

_WAITING = {
    *("client", "daemon", "driver_api", "drivers", "live", "network", "network_faults"),
    *("pattern_host", "view"),
}
"""Folders whose tests wait for sockets, threads or processes, also without the mark."""
LONGEST = (
    *("core/test_kernel_forms", "operator/cli/test_plugin", "network_faults/test_addresses"),
    *("operator/cli/test_calibrate", "drivers/ros2/test_bridge", "drivers/ros1/test_driver"),
    *("swarm/test_garbage", "drivers/crazyflie/test_driver", "operator/calibration/test_lockstep"),
    *("testing/test_driver_contract", "operator/view/test_page_layout", "swarm/test_verbs"),
    *("drivers/ros1/test_life", "drivers/test_daemons", "link/test_udp"),
    *("swarm/test_stolen_robot", "sim/cli/test_classroom", "drivers/ros2/test_bridge_bases"),
    *("drivers/crazyflie/test_swarm", "sim/lockstep/test_broken_assumptions"),
    *("drivers/ros2/test_rmw_zenoh", "drivers/ros2/test_dds_bridge", "drivers/ros2/test_services"),
    *("network_faults/test_links", "faults/test_storage", "faults/test_pattern_host"),
    *("drivers/ros2/test_faults", "faults/test_watchdog", "sim/experiments/test_pool"),
    *("sim/test_portable", "drivers/ros2/test_bridge_commands"),
    *("swarm/test_estop", "faults/test_daemon", "examples/test_notebooks", "sim/view/test_pages"),
    *(
        "operator/cli/test_swarmctl",
        "link/keys/test_files_of_others",
        "robot/protection/test_barrier_closed_loop",
    ),
    *("network_faults/test_strangers", "sim/live/test_demo", "faults/test_scans"),
    *("drivers/ros2/test_node_list", "sim/cli/test_exp", "drivers/ros2/test_last_word"),
    *(
        "sim/cli/test_tour",
        "robot/protection/test_assumption_monitor",
        "network_faults/test_splits",
    ),
    *("sim/live/test_emulators", "sim/experiments/test_tune"),
)
"""Files of tests that take 60 s to 12 s with two cores, the longest first."""
_LONG_FOLDERS = {"protection", "sim", "studies"}


def _is_in(path: Path, names: tuple[str, ...]) -> bool:
    """Whether the path of a file of tests ends with one of `names`."""
    return path.as_posix().endswith(tuple(f"tests/{name}.py" for name in names))


def order(path: Path, is_integration: bool) -> int:
    """The place of a file among all: LONGEST, files that wait and long folders, the others."""
    for place, name in enumerate(LONGEST):
        if _is_in(path, (name,)):
            return place
    is_long = is_integration or not _LONG_FOLDERS.isdisjoint(path.parts)
    return len(LONGEST) + (0 if is_long else 1)


class MixedScheduling(LoadFileScheduling):  # type: ignore[misc]
    """One file at a time for each worker, and one of three workers for files that compute.

    Tests marked `integration` wait for processes most of their time. Together, before the other
    files, they left half of the processors idle; more of them at once make daemons stall. So the
    workers that `computes` names take the other files from the first second on, at a lower
    priority, and end when none is left, if others go on. Those begin with the files that wait.
    """

    def __init__(self, config: pytest.Config, log: object = None) -> None:
        super().__init__(config, log)
        self._found: dict[str, bool] = {}

    def remove_node(self, node: WorkerController) -> str | None:
        """Give back the files of a worker that ended, without tests that are done.

        The test that ended it, which this names, counts as done: it would end the next one, too.
        """
        units = self.assigned_work[node]
        left = {one: tests for one, tests in units.items() if not all(tests.values())}
        self.assigned_work[node] = left
        for tests in left.values():
            ended = next(name for name, is_done in tests.items() if not is_done)
            tests[ended] = True
            if all(tests.values()):
                del left[self._split_scope(ended)]
            super().remove_node(node)
            return str(ended)
        super().remove_node(node)
        return None

    def _assign_work_unit(self, node: WorkerController) -> None:
        if node not in self.registered_collections:
            return  # a replacement of a crashed worker, which still collects
        for_computing = computes(node.gateway.id, self.numnodes)
        fitting = [one for one in self.workqueue if self._waits(one) != for_computing]
        if not fitting and for_computing and self._others_go_on(node):
            node.shutdown()
            return
        self.workqueue.move_to_end((fitting or [*self.workqueue])[0], last=False)
        super()._assign_work_unit(node)

    def _reschedule(self, node: WorkerController) -> None:
        """Give a worker its next file when it begins the last step of one, and not earlier."""
        if node.shutting_down or not self.workqueue:
            super()._reschedule(node)
        elif self._pending_of(self.assigned_work[node]) <= 1:
            self._assign_work_unit(node)

    def _others_go_on(self, node: WorkerController) -> bool:
        """Whether another worker takes the files that wait."""
        others = (one for one in self.nodes if one is not node and not one.shutting_down)
        return not all(computes(one.gateway.id, self.numnodes) for one in others)

    def _waits(self, scope: str) -> bool:
        """Whether a file is in a folder of _WAITING, or marks tests `integration` and none `long`.

        The processes of those that are `long` compute: daemons would wait for a processor.
        """
        if scope not in self._found:
            file: Path = self.config.rootpath / scope
            text = file.read_text() if file.is_file() else ""
            waits = "pytest.mark.integration" in text and "pytest.mark.long" not in text
            self._found[scope] = waits or not _WAITING.isdisjoint(Path(scope).parts)
        return self._found[scope]


def computes(worker: str, workers: int) -> bool:
    """Whether a worker, such as gw5, takes files that compute alone: the last third of them.

    The replacement of a crashed worker has a higher number, and takes any file.
    """
    number = int(re.sub(r"\D", "", worker) or 0)
    return workers - workers // 3 <= number < workers
