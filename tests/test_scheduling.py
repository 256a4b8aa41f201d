"""Files of tests are dealt out to workers: who waits, who computes, and each file once."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.support.scheduling import LONGEST, MixedScheduling, computes, order

MARKED, COMPUTING = ("w0", "w1"), ("tests/sim/test_portable.py", "c1", "c2", "c3")
WAITING = (*MARKED, "drivers/w2")


class Worker:
    """A worker that does a file as soon as it has it."""

    def __init__(self, name: str) -> None:
        self.gateway = SimpleNamespace(id=name)
        self.files: list[str] = []
        self.shutting_down = False
        self._todo: list[int] = []

    def send_runtest_some(self, indices: list[int]) -> None:
        self._todo += indices

    def shutdown(self) -> None:
        self.shutting_down = True

    def do(self, scheduling: Any, tests: list[str]) -> bool:
        """Do what it has; whether there was something."""
        now, self._todo = self._todo, []
        for index in now:
            self.files.append(tests[index].partition("::")[0])
            scheduling.mark_test_complete(self, index)
        return bool(now)


def scheduler(folder: Path, workers: int) -> Any:
    config: Any = SimpleNamespace(
        getvalue=lambda name: [f"{workers}*popen"],
        rootpath=folder,
        option=SimpleNamespace(loadscopereorder=False),
    )
    return MixedScheduling(config)


def ready(scheduling: Any, nodes: list[Worker], tests: list[str]) -> None:
    """All of them have collected."""
    for node in nodes:
        scheduling.add_node(node)
    for node in nodes:
        scheduling.add_node_collection(node, tests)


def dealt(
    folder: Path, files: tuple[str, ...], workers: int, *, last_is_first: bool = False
) -> list[Worker]:
    """The workers after all files are done, three tests each.

    `last_is_first`: the last worker is ready first, and those of few files end but for it.
    """
    for name in files:
        is_long = name == COMPUTING[0]
        mark = "@pytest.mark.integration" if name in MARKED or is_long else ""
        mark += "@pytest.mark.long" if is_long else ""
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(f"{mark}\ndef test(): ...\n")
    scheduling = scheduler(folder, workers)
    tests = [f"{name}::test_{number}" for name in files for number in range(3)]
    nodes = [Worker(f"gw{number}") for number in range(workers)]
    ready(scheduling, nodes[::-1] if last_is_first else nodes, tests)
    scheduling.schedule()
    while any([node.do(scheduling, tests) for node in nodes]):
        pass
    assert not scheduling.has_pending
    assert all(node.shutting_down for node in nodes)
    return nodes


@pytest.mark.parametrize("files", [COMPUTING + WAITING, WAITING, COMPUTING, COMPUTING[:1]])
@pytest.mark.parametrize("workers", [1, 3, 5])
def test_each_test_is_done_once(tmp_path: Path, files: tuple[str, ...], workers: int) -> None:
    done = [file for node in dealt(tmp_path, files, workers) for file in node.files]
    assert sorted(done) == sorted(3 * files)


@pytest.mark.parametrize(("files", "workers"), [(WAITING[:1], 3), (WAITING[:2], 6)])
def test_a_worker_that_computes_takes_files_that_wait_if_it_is_left_alone(
    tmp_path: Path, files: tuple[str, ...], workers: int
) -> None:
    """Of more workers than files, the first that are ready remain."""
    nodes = dealt(tmp_path, files, workers, last_is_first=True)
    assert sorted(file for node in nodes for file in node.files) == sorted(3 * files)


def test_tests_that_end_their_worker_are_not_done_again_and_the_others_are(tmp_path: Path) -> None:
    """Two workers end at the same time, the second while what replaces the first collects."""
    files = ("c0", "c1", "c2")
    for name in files:
        (tmp_path / name).touch()
    tests = [f"{name}::test_{number}" for name in files for number in range(3)]
    scheduling, nodes = scheduler(tmp_path, 2), [Worker("gw0"), Worker("gw1")]
    ready(scheduling, nodes, tests)
    scheduling.schedule()
    for number in range(3):  # c0 is done
        scheduling.mark_test_complete(nodes[0], number)
    third = Worker("gw2")
    ended = [scheduling.remove_node(nodes[0])]
    scheduling.add_node(third)
    ended.append(scheduling.remove_node(nodes[1]))
    scheduling.add_node_collection(third, tests)
    scheduling.schedule()
    while third.do(scheduling, tests):
        pass
    assert sorted(map(str, ended)) == ["c1::test_0", "c2::test_0"]
    assert sorted(third.files) == ["c1", "c1", "c2", "c2"]
    assert not scheduling.has_pending
    assert third.shutting_down


def test_files_that_wait_come_first_and_not_to_the_worker_that_computes(
    tmp_path: Path,
) -> None:
    one, two, last = dealt(tmp_path, ("drivers/w2", *COMPUTING, *MARKED), 3)
    assert {one.files[0], two.files[0]} == {"drivers/w2", "w0"}
    assert last.files[0] == COMPUTING[0]
    assert not {*last.files} & {*WAITING}
    assert {*one.files, *two.files} & {*COMPUTING}


@pytest.mark.parametrize(("workers", "found"), [(1, []), (4, [3]), (5, [4]), (6, [4, 5])])
def test_a_third_of_the_workers_computes(workers: int, found: list[int]) -> None:
    assert [n for n in range(workers + 2) if computes(f"gw{n}", workers)] == found


def test_the_longest_files_come_first_and_short_ones_that_compute_last() -> None:
    here = Path(__file__).parent
    files = [here / f"{name}.py" for name in LONGEST]
    assert [path for path in files if not path.is_file()] == []
    files += [here / "sim" / "x.py", here / "core" / "x.py"]
    places = [order(path, is_integration=False) for path in files]
    assert places == sorted({*places})
    assert order(here / "core" / "x.py", is_integration=True) == places[-2]
