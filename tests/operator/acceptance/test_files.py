"""What remains of a test: samples of recordings, the folder, the zip, and what it hides."""

from __future__ import annotations

import json
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.events import DriverInput
from swarmd.core.finding import Finding
from swarmd.core.goal import GoalRecord
from swarmd.core.messages import State
from swarmd.core.values import Platform
from swarmd.daemon.recording.head import RecordingHead, head_of
from swarmd.daemon.recording.reader import read_file
from swarmd.daemon.robot_setup import configured_robot
from swarmd.operator.acceptance.evidence import Samples
from swarmd.operator.acceptance.html_report import page
from swarmd.operator.acceptance.redaction import Mask, masked_recording
from swarmd.operator.acceptance.result_file import (
    RECORD,
    RECORDINGS,
    REPORT,
    SCHEMA,
    AcceptanceRecord,
    read_record,
    record_for,
    result_of,
    schema,
    subject_of,
    with_step,
    write_file,
    write_record,
)
from swarmd.operator.acceptance.samples import read_samples
from swarmd.operator.acceptance.steps import steps_of
from swarmd.operator.acceptance.stops import after_stop
from swarmd.operator.acceptance.verdict import Result, failed, not_shown, passed
from swarmd.robot.latches import LatchRecord
from swarmd.robot.setup import RobotIdentity, RobotSetup
from swarmd.settings.platforms import load_platform
from swarmd.settings.settings import load_daemon_settings
from tests.support.chromium import FOUND, browser
from tests.support.recorded_stories import Story, repeat

STEPS = steps_of(load_platform("burger"))
ORDER = [step.id for step in STEPS]
RECORD_BEFORE = AcceptanceRecord(
    robot="tb3-01", platform="burger", driver="ros2dds", began="2026-11-27"
)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Three seconds of a drive towards obstacles, and a stop."""
    story = Story(tmp_path / "recorded")
    story.recorder.begin(story.robot)
    story.robot.step(DriverInput(True, "bridge at 10.0.0.7 of anna@desk"))
    story.run("drive")
    story.robot.ask("stop")
    story.robot.advance(1.0)
    assert story.robot.robot.state is State.STOPPED
    return story.recorder.finish().path


def test_samples_have_what_the_robot_got_and_decided(recording: Path) -> None:
    samples = read_samples([read_file(recording)])
    scans, stop = samples.scans, samples.stops[-1]
    assert len(scans) > 10
    assert all(len(scan.bearings) == len(scan.ranges) == 360 for _, scan in scans)
    assert len(samples.odometry) > 30
    assert samples.driver_states[-1].text == "bridge at 10.0.0.7 of anna@desk"
    assert 2.5 < stop - scans[0][0] < 4.5
    drove = [one for one in samples.decisions if not one.safe.is_zero]
    assert drove
    assert max(one.at for one in drove) <= stop
    assert min(one.gap for one in drove) < 1.0
    assert samples.wall == pytest.approx(1.7e9 - scans[0][0], abs=10.0)


def test_several_recordings_are_one_track(recording: Path) -> None:
    file = read_file(recording)
    once, twice = read_samples([file]), read_samples([file, file])
    assert len(twice.inputs) == 2 * len(once.inputs)


def test_a_masked_recording_has_the_same_numbers_and_no_names(
    recording: Path, tmp_path: Path
) -> None:
    mask = Mask(["anna", "desk", "r"])
    masked = tmp_path / "masked.mcap"
    masked.write_bytes(masked_recording(recording, mask))
    before, after = (read_samples([read_file(path)]) for path in (recording, masked))
    assert after.driver_states[-1].text == "bridge at 00.0.0.0 of xxxx@xxxx"
    assert [at for at, _ in after.scans] == [at for at, _ in before.scans]
    for (_, one), (_, other) in zip(before.scans, after.scans, strict=True):
        assert np.array_equal(one.ranges, other.ranges)
    assert after.odometry == before.odometry
    assert after.stops == before.stops
    for message in read_file(masked).messages:
        assert b"anna" not in message.payload
        assert b"10.0.0.7" not in message.payload


def test_a_masked_recording_still_replays_to_the_bit(recording: Path, tmp_path: Path) -> None:
    masked = tmp_path / "masked.mcap"
    masked.write_bytes(masked_recording(recording, Mask(["anna"])))
    _, parity = repeat([read_file(masked)], {})
    assert parity.safe.count > 50
    assert parity.safe.is_equal


def test_without_a_mask_the_recording_is_the_file(recording: Path) -> None:
    assert masked_recording(recording, Mask(["anna"], is_on=False)) == recording.read_bytes()


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("anna@desk is up", "xxxx@xxxx is up"),
        ("annabel at desktop", "annabel at desktop"),
        ("pi of the pipe", "xx of the pipe"),
        ("wlan0: up, 10.0.0.5/24", "wlan0: up, 00.0.0.0/00"),
        ("fe80::ba27:ebff:fe12:3456", "0000::0000:0000:0000:0000"),
        ("b8:27:eb:12:34:56", "00:00:00:00:00:00"),
        ("/home/bob/lab/x.yaml", "/xxxx/xxx/lab/x.yaml"),
        ("swarmd 0.1.2 at 0.22 m/s, 12:30:15", "swarmd 0.1.2 at 0.22 m/s, 12:30:15"),
    ],
)
def test_names_and_addresses_are_hidden_and_nothing_else(text: str, wanted: str) -> None:
    assert Mask(["anna", "desk", "pi", ""]).text(text).replace("/00", "/24") == wanted.replace(
        "/00", "/24"
    )
    assert Mask(["anna"], is_on=False).text(text) == text


def whole_record() -> AcceptanceRecord:
    record = msgspec.structs.replace(
        RECORD_BEFORE, versions={"swarmd": "0.1 of anna"}, private=("anna",)
    )
    verdicts = [
        passed("ok", "5 Hz", "4.5 Hz", rate=5.0),
        failed("<b>bad</b> by anna"),
        not_shown("no"),
    ]
    for number, step in enumerate(STEPS):
        result = result_of(step, verdicts[number % 3], [f"{step.id}.mcap"])
        record = with_step(record, result, ORDER)
    return msgspec.structs.replace(record, is_whole=True)


def test_a_record_is_read_as_it_was_written(tmp_path: Path) -> None:
    write_record(tmp_path, whole_record())
    assert read_record(tmp_path) == whole_record()
    assert read_record(tmp_path).verdicts["A1"].values == {"rate": 5.0}


def test_a_step_replaces_its_earlier_verdict_and_keeps_the_order() -> None:
    record = RECORD_BEFORE
    for id in ("B1", "A1", "B1"):
        step = next(step for step in STEPS if step.id == id)
        verdict = passed(f"{id} {len(record.steps)}")
        record = with_step(record, result_of(step, verdict, ()), ORDER)
    assert [(one.id, one.verdict.reason) for one in record.steps] == [
        ("A1", "A1 1"),
        ("B1", "B1 2"),
    ]


def test_the_headline_names_the_failures() -> None:
    record = whole_record()
    assert "FAIL (A2, A5" in record.headline
    assert record.counts[Result.PASS] == 16
    one = with_step(RECORD_BEFORE, record.steps[0], ORDER)
    assert "no failure" in one.headline
    assert "not all" in one.headline


@pytest.mark.parametrize("keeps_names", [False, True])
def test_the_file_has_all_parts_and_hides_names(
    tmp_path: Path, recording: Path, keeps_names: bool
) -> None:
    folder, path = tmp_path / "folder", tmp_path / "acceptance.zip"
    (folder / RECORDINGS / "tb3-01").mkdir(parents=True)
    (folder / RECORDINGS / "tb3-01" / "A6.mcap").write_bytes(recording.read_bytes())
    (folder / "platform-before.yaml").write_text("description: of anna\n")
    write_record(folder, whole_record())
    report = page(whole_record(), {"A6": read_samples([read_file(recording)]), "B1": Samples()})
    write_file(folder, path, report, Mask(["anna"], is_on=not keeps_names))
    with zipfile.ZipFile(path) as file:
        names = set(file.namelist())
        content = {name: file.read(name) for name in names}
    assert names == {RECORD, SCHEMA, REPORT, "platform-before.yaml", f"{RECORDINGS}/A6.mcap"}
    texts = (RECORD, REPORT, "platform-before.yaml")
    assert all((b"anna" in content[name]) is keeps_names for name in texts)
    assert json.loads(content[SCHEMA]) == json.loads(json.dumps(schema()))
    assert read_record(path).verdicts.keys() == set(ORDER)
    assert read_record(path).private == ()


def test_the_report_begins_with_the_verdict_and_escapes() -> None:
    text = page(whole_record(), {})
    assert text.index("FAIL (A2") < text.index("<table>")
    assert "<b>bad" not in text
    assert "&lt;b&gt;bad" in text
    assert all(f"{step.id} {step.name}" in text for step in STEPS)


@pytest.mark.integration
@pytest.mark.skipif(FOUND is None, reason="no Chromium")
def test_a_telephone_shows_reasons_in_its_whole_width(tmp_path: Path) -> None:
    """At 360 px the column of reasons had had room for three letters a line."""
    path = tmp_path / "report.html"
    path.write_text(page(whole_record(), {}))
    with browser(tmp_path / "browser", 360, 740) as shown:
        shown.call("Page.enable")
        shown.call("Page.navigate", url=path.as_uri())
        shown.until(
            "document.readyState === 'complete' && !!document.querySelector('td')", "loaded"
        )
        widths = shown.evaluate(
            "[...document.querySelectorAll('td:last-child')].map(e => e.clientWidth)"
        )
        assert len(widths) > 40
        assert min(widths) > 250
        assert shown.evaluate("document.documentElement.scrollWidth") <= 360


def test_the_report_says_of_which_parts_no_step_was_asked() -> None:
    whole = whole_record()
    record = msgspec.structs.replace(
        whole, steps=tuple(one for one in whole.steps if one.id[0] in "AB")
    )
    assert page(record, {}).count("no step of this part was asked yet") == 2  # C and D
    assert "was asked yet" not in page(whole, {})


TESTED = {"robot": "tb3-01", "swarm": "s", "platform": "p", "driver": "ros2dds", "base": "b"}
DAY = 86400.0
JUDGED_AT = 1_700_000_000.0


def all_passed(at: float = JUDGED_AT) -> AcceptanceRecord:
    """All steps have passed, at `at` s since 1970."""
    record = msgspec.structs.replace(RECORD_BEFORE, subject=TESTED)
    for step in STEPS:
        record = with_step(record, result_of(step, passed("ok"), (), at, TESTED), ORDER)
    return record


@pytest.mark.parametrize("name", ["", *TESTED])
def test_a_pass_lets_only_the_same_robot_move(name: str) -> None:
    subject = {**TESTED, **({name: "another"} if name else {})}
    later = msgspec.structs.replace(all_passed(), subject=subject)
    dropped = all_passed().verdicts.keys() - later.verdicts_on(STEPS, JUDGED_AT + 60.0).keys()
    assert dropped == ({"B1", "C2"} if name else set())


@pytest.mark.parametrize(
    ("age", "counts"), [(0.0, True), (DAY - 1.0, True), (DAY + 1.0, False), (-1.0, False)]
)
def test_a_pass_lets_the_robot_move_for_a_day(age: float, counts: bool) -> None:
    assert ("B1" in all_passed().verdicts_on(STEPS, JUDGED_AT + age)) is counts


def test_a_pass_without_a_subject_lets_nothing_move() -> None:
    """As an earlier version wrote it."""
    old = msgspec.structs.replace(whole_record(), subject=TESTED)
    assert "B1" not in old.verdicts_on(STEPS, 60.0)


@pytest.mark.parametrize("name", ["", "robot", "swarm"])
def test_the_results_of_another_robot_are_not_continued(tmp_path: Path, name: str) -> None:
    new = msgspec.structs.replace(all_passed(), steps=(), subject={**TESTED, "platform": "q"})
    assert record_for(tmp_path, new) == new
    before = {**TESTED, **({name: "another"} if name else {})}
    write_record(
        tmp_path, msgspec.structs.replace(all_passed(), subject=before, robot=before["robot"])
    )
    if name:
        with pytest.raises(ConfigError, match="another"):
            record_for(tmp_path, new)
    else:
        found = record_for(tmp_path, new)
        assert (len(found.steps), found.subject["platform"]) == (len(STEPS), "q")


@pytest.mark.parametrize(
    ("fields", "name"),
    [
        ({}, ""),
        ({"robot": "tb3-02"}, "robot"),
        ({"swarm": "t"}, "swarm"),
        ({"platform": load_platform("waffle_pi")}, "platform"),
        ({"platform": replace(load_platform("burger"), body={})}, "platform"),
        ({"driver": "ros1"}, "driver"),
        ({"base": "other options"}, "base"),
    ],
)
def test_a_head_tells_what_is_tested(fields: dict[str, Any], name: str) -> None:
    assert differing(subject_of(head()), subject_of(head(**fields))) == ([name] if name else [])


def test_the_options_of_a_driver_tell_its_base() -> None:
    """A Crazyflie by its address; equal options in another order are equal."""
    one, other = {"uri": "radio://0/80/2M/E7E7E7E701"}, {"uri": "radio://0/80/2M/E7E7E7E702"}
    found = [daemon_base({**options, "rate": 100}) for options in (one, other)]
    assert found[0] != found[1]
    assert found[0] == daemon_base({"rate": 100, **one})


def daemon_base(options: dict[str, Any]) -> str:
    """What the daemon of a Crazyflie with these options tells of its base."""
    overrides = {"id": "r", "platform": "crazyflie", "driver": "crazyflie", "insecure": True}
    settings = load_daemon_settings(None, {**overrides, "driver_options": options})
    robot = configured_robot(settings, "00", 1, latches=LatchRecord(), goals=GoalRecord())
    return robot.identity.setup.base


def differing(one: dict[str, str], other: dict[str, str]) -> list[str]:
    return [name for name in one if one[name] != other[name]]


def head(
    robot: str = "tb3-01",
    swarm: str = "s",
    platform: Platform = load_platform("burger"),  # noqa: B008  # a value
    driver: str = "ros2dds",
    base: str = "options",
) -> RecordingHead:
    """As a recording of a robot has it, once it was written and read."""
    setup = RobotSetup(driver=driver, base=base)
    identity = RobotIdentity(robot=robot, platform=platform, setup=setup, seed=1, instance="i")
    made = RecordingHead(swarm=swarm, clock="c", machine="m", identity=identity)
    return head_of(made.texts(), "")


@pytest.mark.parametrize("content", [b"", b"no zip", b"PK\x05\x06" + bytes(18)])
def test_a_file_that_is_no_result_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.zip"
    path.write_bytes(content)
    for place in (path, tmp_path, tmp_path / "none"):
        with pytest.raises(ConfigError):
            read_record(place)


def test_a_recorded_stop_is_judged(recording: Path) -> None:
    """The harness has no base: odometry stands, so that the stop shows no drive."""
    from swarmd.operator.acceptance.evidence import Evidence

    samples = read_samples([read_file(recording)])
    evidence = Evidence(load_platform("burger"), samples, findings=(Finding("x", True, "y"),))
    found = after_stop()(replace(evidence, samples=samples))
    assert found.result is Result.FAIL
    assert "did not drive" in found.reason
