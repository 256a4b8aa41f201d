"""Export of an experiment for other programs: tables as CSV or Parquet, runs as MCAP."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from swarmd.core.errors import SwarmError
from swarmd.core.files import whole_file
from swarmd.core.values import Array, Odometry, Pose, Twist
from swarmd.sim.experiments.plan import Run
from swarmd.sim.experiments.results import Results
from swarmd.sim.trace import Trace

Form: TypeAlias = Literal["csv", "parquet", "mcap"]


def export(results: Results, form: Form, out: Path, *, traces: bool = True) -> Iterator[Path]:
    """Write the finished runs of an experiment into the folder `out`; yield the path of each file.

    As CSV or Parquet, the file `results` has a row for each run, and the file `traces/RUN` has a
    row for each instant and robot. Without `traces` only `results` is written. As MCAP, each run is
    a file `RUN.mcap`. Files are written atomically. SwarmError if a trace is missing, or if a file
    cannot be written.
    """
    if form != "mcap":
        yield _written(out / f"results.{form}", partial(_save, results.frame(), form))
    for number, run in enumerate(results.runs if traces else ()):
        trace = results.traces[number]
        if form == "mcap":
            yield _written(out / f"{run.id}.mcap", partial(write_mcap, trace))
        else:
            table = _long(trace, run)
            yield _written(out / "traces" / f"{run.id}.{form}", partial(_save, table, form))


def _long(trace: Trace, run: Run) -> Any:
    """The table of a trace, with the run's name, variant and seed, so that tables can be joined."""
    table = trace.frame()
    about = {"run": run.id, "variant": run.variant.name, "seed": run.seed}
    for place, (name, value) in enumerate(about.items()):
        table.insert(place, name, value)
    return table


def _save(table: Any, form: Form, path: Path) -> None:
    if form == "csv":
        table.to_csv(path, index=False)
    else:
        table.to_parquet(path, index=False)


def _written(path: Path, write: Callable[[Path], None]) -> Path:
    """The path, once `write` has written the file."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as unfinished:
            write(unfinished)
    except OSError as error:
        text = f"{path}: cannot be written: {error.strerror or error}"
        raise SwarmError(f"{text}; make room or name another place") from error
    except ImportError as error:  # pyarrow, which pandas imports for Parquet
        text = f"{path.suffix[1:]} needs {error.name or 'pyarrow'}"
        raise SwarmError(f"{text}: pip install 'swarmd[table]'") from error
    return path


def write_mcap(trace: Trace, path: Path) -> None:
    """Write a run as MCAP with the ROS 2 messages of a robot's recording; time begins at 0.

    Topics of each robot:

    - `ground_truth`: Odometry with the true pose and speed in the arena's frame, whose name in the
      messages is odom;
    - `command/safe` and `command/requested`;
    - `report` and `readings`: numbers by name;
    - `status`: JSON of state, reason and reported texts, when one of them changes.
    """
    from mcap.writer import CompressionType, Writer

    from swarmd.recording.writer import METADATA, PROFILE, Channels

    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(PROFILE, "swarmd")
        channels = Channels(writer)
        about = {"ids": trace.ids, "platforms": trace.platforms, "meta": dict(trace.meta)}
        writer.add_metadata(METADATA, {"trace": json.dumps(about)})
        for at, topic, (kind, payload) in _messages(trace):
            writer.add_message(channels.id_of(topic, kind), at, payload, at)
        writer.finish()  # type: ignore[no-untyped-call]


def _messages(trace: Trace) -> Iterator[tuple[int, str, tuple[str, bytes]]]:
    """The messages of a trace in the order of time: time in ns from 0 on, topic, (type, payload).

    A robot without a pose at an instant has no message then. A status is given when it changes.
    """
    from swarmd.recording import messages

    speeds = _speeds(trace)
    last_status: dict[int, str] = {}  # by robot
    for k, t in enumerate(trace.t.tolist()):
        time_ns = round(1e9 * (t - float(trace.t[0])))
        stamp = 1e-9 * time_ns
        for i, robot in enumerate(trace.ids):
            if not np.isfinite(trace.pose[k, i]).all():
                continue
            odometry = Odometry(stamp, _pose(trace.pose[k, i]), _twist(speeds[k, i]))
            yield time_ns, f"/{robot}/ground_truth", messages.odometry_message(odometry)
            for topic, message in _command_messages(trace, k, i, stamp):
                yield time_ns, f"/{robot}/{topic}", message
            for topic, arrays in (("report", trace.report), ("readings", trace.readings)):
                values = {name: float(array[k, i]) for name, array in arrays.items()}
                known = {name: value for name, value in values.items() if not np.isnan(value)}
                if known:
                    yield time_ns, f"/{robot}/{topic}", messages.readings_message(known, stamp)
            status = json.dumps(_status(trace, k, i))
            if status != last_status.get(i):
                last_status[i] = status
                yield time_ns, f"/{robot}/status", messages.text_message(status, stamp)


def _command_messages(
    trace: Trace, k: int, i: int, stamp: float
) -> Iterator[tuple[str, tuple[str, bytes]]]:
    """The commands of robot `i` at instant `k`: topic, (type, payload).

    The messages of a recording hold the number of a scan. A trace does not know this number, so the
    messages hold the number of the instant.
    """
    from swarmd.recording.messages import requested_message

    yield "command/safe", requested_message(_twist(trace.safe[k, i]), k, stamp)
    if trace.requested is not None:
        requested = _twist(trace.requested[k, i])
        yield "command/requested", requested_message(requested, k, stamp)


def _status(trace: Trace, k: int, i: int) -> dict[str, str]:
    """State, reason and reported texts of robot `i` at instant `k`, by name."""
    arrays = {"state": trace.state, "reason": trace.reason}
    texts = {name: str(array[k, i]) for name, array in arrays.items() if array is not None}
    return texts | {f"report:{name}": str(array[k, i]) for name, array in trace.words.items()}


def _speeds(trace: Trace) -> Array:
    """(T, n, 3) the true speeds: linear, angular, lateral, by central differences."""
    if len(trace.t) < 2:
        return np.zeros_like(trace.pose)
    step = np.gradient(trace.pose, trace.t, axis=0)
    cos, sin = np.cos(trace.pose[..., 2]), np.sin(trace.pose[..., 2])
    ahead = step[..., 0] * cos + step[..., 1] * sin
    aside = step[..., 1] * cos - step[..., 0] * sin
    return np.stack((ahead, step[..., 2], aside), axis=-1)


def _pose(values: Array) -> Pose:
    return Pose(*map(float, values))


def _twist(values: Array) -> Twist:
    return Twist(*map(float, values))
