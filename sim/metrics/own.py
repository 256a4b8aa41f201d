"""Custom metrics: a function of a trace, in a file or in an installed package.

::

    import numpy as np

    from swarmd.sim.metrics.own import metric

    @metric(unit="share", better="more")
    def warm(trace):
        '''Robots within 1 m of the warm spot.'''
        return (np.hypot(trace.pose[..., 0] - 1.5, trace.pose[..., 1]) < 1.0).mean(axis=1)

The function returns the value of the metric for the run, a number, or None if the run has no value.
It may also return an array (T,) of values over time. The value for the run is then their mean in
the last 60 s, or in the last half of a run shorter than 120 s.

The metric of a file is named `path/to/file.py:warm`, the metric of a package by its entry point in
the group `swarmd.metrics`. The decorator may be left out.
"""

from __future__ import annotations

import hashlib
import inspect
import math
import traceback
from collections.abc import Callable, Mapping
from numbers import Real
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from swarmd.core.errors import ConfigError, SwarmError, named, unknown
from swarmd.core.files import read_regular, real_path
from swarmd.core.values import Array
from swarmd.pattern_host.loader import import_file
from swarmd.plugins import entry_points_of
from swarmd.sim.metrics.metric import Better, Metric, over_time
from swarmd.sim.trace import Trace

GROUP = "swarmd.metrics"
_Function = TypeVar("_Function", bound=Callable[[Trace], Any])


class MetricError(SwarmError):
    """A custom metric raised an error, or its result is no value."""


def metric(
    *,
    unit: str = "",
    better: Better | None = None,
    is_time_to_event: bool = False,
    bounds: tuple[float, float] | None = None,
) -> Callable[[_Function], _Function]:
    """Make a function of a trace a metric with a unit and a direction.

    `better`: the better direction; None if it depends on the task. `is_time_to_event`: the value is
    a duration in s, None where the event never happened. `bounds`: the least and the largest value
    that a run can have, which `exp run --until` needs; None: not known.
    """

    def decorated(function: _Function) -> _Function:
        attributes = {"unit": unit, "better": better, "is_time_to_event": is_time_to_event}
        vars(function).update(attributes, bounds=bounds)
        return function

    return decorated


def digest_of_file(text: str) -> str:
    """The SHA-256 of the file of `FILE.py:FUNCTION`; ConfigError if it cannot be read."""
    file = text.rpartition(":")[0]
    try:
        return hashlib.sha256(read_regular(file)).hexdigest()
    except OSError as error:
        raise ConfigError(f"metric {text!r}: {file} cannot be read: {error.strerror}") from error


def metric_of_file(text: str, digest: str = "") -> Metric:
    """The metric `FILE.py:FUNCTION`; ConfigError if file or function are missing or faulty.

    The metric's name is `FILE.py:FUNCTION` without folders. `digest`: the SHA-256 that the file
    must have; empty: any.
    """
    file, _, name = text.rpartition(":")
    path = real_path(Path(file))
    file_digest = digest_of_file(text)
    if digest not in ("", file_digest):
        raise ConfigError(f"metric {text!r}: {file} was changed meanwhile; run it again")
    try:
        module = import_file(path, bytes.fromhex(file_digest))
    except Exception as error:
        raise ConfigError(f"metric {text!r}: {type(error).__name__}: {error}") from error
    # Public functions that the file defines, without those that it imports.
    functions = {
        key: value
        for key, value in vars(module).items()
        if inspect.isfunction(value) and value.__module__ == module.__name__ and key[0] != "_"
    }
    if name not in functions:
        raise ConfigError(f"{file}: {unknown('metric', name, list(functions))}")
    metric_name = f"{path.name}:{name}"
    origin = f"{path}:{name}"
    return _metric(metric_name, functions[name], origin, file_digest, str(path))


def installed_metrics() -> Mapping[str, Metric]:
    """The metrics of installed packages by name; ConfigError if an import fails."""
    metrics = {}
    for point in sorted(entry_points_of(GROUP)):
        try:
            function = point.load()
            source = inspect.getsourcefile(function)
        except Exception as error:
            text = f"metric {point.name!r} of {point.value}: {type(error).__name__}: {error}"
            raise ConfigError(f"{text}; reinstall its package") from error
        data = Path(source).read_bytes() if source else b""
        about = point.dist.name if point.dist is not None else point.value
        digest = hashlib.sha256(data).hexdigest()
        metrics[point.name] = _metric(point.name, function, point.name, digest, about)
    return metrics


def _metric(
    name: str, function: Callable[[Trace], Any], origin: str, digest: str, source: str
) -> Metric:
    """The metric of a function, whose attributes are set by the decorator `metric`.

    `origin`: the text that names the function on the command line. `digest`: the SHA-256 of its
    file. `source`: the file or package, for tables. If the function returns an array over time, the
    value of a run is its mean at the end of the run, as the module says. ConfigError for a wrong
    attribute `better` or `bounds`.
    """
    better = getattr(function, "better", None)
    if better not in (None, "less", "more"):
        raise ConfigError(f"metric {name}: better is {better!r}; expected 'less' or 'more'")
    bounds = getattr(function, "bounds", None)
    if bounds is not None and not (
        isinstance(bounds, tuple)
        and len(bounds) == 2
        and all(isinstance(bound, Real) for bound in bounds)
        and 0.0 < bounds[1] - bounds[0] < math.inf
    ):
        raise ConfigError(f"metric {name}: bounds is {bounds!r}; expected a range such as (0, 1)")

    def value(trace: Trace) -> float | None:
        result = _called(name, function, trace)
        return over_time(result, trace.t, "late") if isinstance(result, np.ndarray) else result

    def series(trace: Trace) -> Array | None:
        result = _called(name, function, trace)
        return result if isinstance(result, np.ndarray) else None

    return Metric(
        name=name,
        unit=str(getattr(function, "unit", "")),
        meaning=(inspect.getdoc(function) or "").partition("\n")[0],
        source=source,
        value=value,
        series=series,
        better=better,
        is_time_to_event=bool(getattr(function, "is_time_to_event", False)),
        bounds=bounds,
        origin=origin,
        digest=digest,
    )


def _called(name: str, function: Callable[[Trace], Any], trace: Trace) -> Array | float | None:
    """The result of the function; MetricError with the line of the file if it is no value."""
    try:
        result = function(trace)
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(frame.filename).name}:{frame.lineno}"
        raise MetricError(f"{type(error).__name__}: {error} ({where})") from error
    if result is None or isinstance(result, (bool, int, float, np.number, np.bool_)):
        return None if result is None else float(result)
    if isinstance(result, np.ndarray) and result.shape in ((), trace.t.shape):
        return result.astype(np.float64) if result.ndim else float(result)
    what = f"an array {result.shape}" if isinstance(result, np.ndarray) else named(result)
    raise MetricError(f"{name} gave {what}; expected a number, None or an array {trace.t.shape}")
