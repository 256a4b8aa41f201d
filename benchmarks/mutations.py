"""What a mutant is, the mechanisms of protection, and a textual change for each."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from swarmd.errors import SwarmError


@dataclass(frozen=True, slots=True)
class Mutant:
    """One mechanism, and the change in a file that takes it out: `old`, there once, gets `new`.

    `also`: another old and new in the same file, of what is done in two places. `tests`: what is
    to notice it, a folder or a file.
    """

    mechanism: str
    change: str
    path: str
    old: str
    new: str
    also: tuple[str, str] | None = None
    tests: str = "tests/protection"

    def apply(self, tree: Path) -> None:
        """Change the file in a tree; SwarmError if the text is not there exactly once."""
        path = tree / self.path
        text = path.read_text()
        for old, new in ((self.old, self.new), *([self.also] if self.also else [])):
            found = text.count(old)
            if found != 1:
                raise SwarmError(
                    f"mutant '{self.mechanism}': {self.path} holds its text {found} times; wanted"
                    " is once: bring it in step with the sources"
                )
            text = text.replace(old, new)
        path.write_text(text)


def mutants_of(path: str, tests: str, *rows: tuple[str, str, str, str]) -> tuple[Mutant, ...]:
    """Mutants of one file, each a row: mechanism, change, old and new."""
    return tuple(
        Mutant(what, change, path, old, new, tests=tests) for what, change, old, new in rows
    )


_BARRIER = "swarmd/protection/barrier.py"
_FRONT = "swarmd/protection/front.py"
_MEMORY = "swarmd/protection/memory.py"
_MOTION = "swarmd/protection/motion.py"
_PRESSING = "swarmd/protection/pressing.py"
_REACH = "swarmd/protection/reach.py"
_SCANS = "swarmd/scans/conditioning.py"
_SENSES = "swarmd/robot/senses.py"
_SWEEP = "swarmd/protection/sweep.py"

MUTANTS = (
    Mutant(
        "braking distance",
        "braking is a hundred times as good as it is",
        _BARRIER,
        "return passive_caps(room, braking,",
        "return passive_caps(room, 100.0 * braking,",
        also=(
            "self._outline, settings.braking_linear, settings.braking_angular, TICK",
            "self._outline, 100 * settings.braking_linear, 100 * settings.braking_angular, TICK",
        ),
    ),
    Mutant(
        "speed of others",
        "others are taken to stand still",
        _BARRIER,
        "passive_caps(room, braking, settings.others_speed,",
        "passive_caps(room, braking, 0.0,",
        also=("others = settings.others_speed if", "others = 0.0 if"),
    ),
    Mutant(
        "unseen extent",
        "others reach no further than what is seen of them",
        _BARRIER,
        "return self._settings.margin + self._settings.unseen_extent + blurred",
        "return self._settings.margin + blurred",
    ),
    Mutant(
        "margin",
        "nothing is kept free beside what may be there",
        _BARRIER,
        "return self._settings.margin + self._settings.unseen_extent + blurred",
        "return self._settings.unseen_extent + blurred",
    ),
    Mutant(
        "reach",
        "what the robot covers itself while a sweep ages does not count",
        _REACH,
        "(settings.others_speed + speed) * age",
        "settings.others_speed * age",
    ),
    Mutant(
        "latency",
        "a sweep was taken when it arrives",
        _BARRIER,
        "latency, age = self._spec.latency,",
        "latency, age = 0.0,",
    ),
    Mutant(
        "dead reckoning",
        "the robot is where it was when the sweep was taken",
        _BARRIER,
        "frame = relative(self._taken_at, self._motion.ahead(moment, command))",
        "frame = Pose()",
    ),
    Mutant(
        "true footprint",
        "the outline is the circle of half its width around the axle",
        _BARRIER,
        "self._outline = Footprint(platform.footprint)",
        "_w = float(platform.footprint[:, 1].max())\n"
        "        _a = np.arange(16) * (np.pi / 8.0)\n"
        "        self._outline = Footprint(_w * np.stack((np.cos(_a), np.sin(_a)), axis=1))",
    ),
    Mutant(
        "axle where it is",
        "the outline is centred on the axle",
        _BARRIER,
        "self._outline = Footprint(platform.footprint)",
        "self._outline = Footprint(platform.footprint - platform.footprint.mean(axis=0))",
    ),
    Mutant(
        "envelope",
        "corners may be as fast as the base can",
        _BARRIER,
        "        if not self._seen.is_near:\n",
        "        if True:\n",
    ),
    Mutant(
        "the stop is followed",
        "a command is right if its rows are",
        _SWEEP,
        "if self._is_clear(speeds[None], along, points, gaps, free)[0]:",
        "if True:",
    ),
    Mutant(
        "brakes that are better than told",
        "both speeds are shed as slowly as they may be",
        _SWEEP,
        "((linear, angular), (np.inf, angular), (linear, np.inf))",
        "((linear, angular), (linear, angular), (linear, angular))",
    ),
    Mutant(
        "sliding",
        "what it slides along is met where it was seen alone",
        _BARRIER,
        "rows = joined(rows, sliding(rows, facing, self._outline.corners, along, rest, CREEP))",
        "rest *= 1.0",
    ),
    Mutant(
        "creep",
        "in touch with something it is as fast as near it",
        _BARRIER,
        "CREEP if is_touching else self._speed",
        "self._speed",
    ),
    Mutant(
        "creep where none sees",
        "what comes nearer than the sensor sees touches only once it is too close",
        _BARRIER,
        "settings.margin + settings.unseen_extent + self._hidden_gap(platform.scan)",
        "settings.margin + settings.unseen_extent",
    ),
    Mutant(
        "own corners",
        "only the nearest place of the outline counts against what is not seen of others",
        _BARRIER,
        "if self._settings.unseen_extent > 0.0:",
        "if False:",
    ),
    Mutant(
        "too close is contact",
        "a ray that is too close to measure sees nothing",
        _BARRIER,
        "bearings = scan.bearings[scan.ranges == -np.inf]",
        "bearings = scan.bearings[:0]",
    ),
    Mutant(
        "never along a ray that is too close",
        "such a return has the row of the nearest place of the outline alone",
        _BARRIER,
        "x * ny - y * nx, zeros, x, y, zeros),",
        "x * ny - y * nx, zeros + 100.0, x, y, zeros),",
    ),
    Mutant(
        "keep-out",
        "no circle is kept free around a sensor that is blind nearby",
        _BARRIER,
        "rows = self._with_keep_out(rows, self._settings.keep_out, along, age)",
        "pass",
    ),
    Mutant(
        "memory of the blind zone",
        "what a blind sensor no longer sees is not there",
        _MEMORY,
        'if spec.near == "reported" or spec.range_min <= 0.0:',
        "if True:",
    ),
    Mutant(
        "faces too wide to vanish",
        "what goes on inside is hidden only where nothing is seen beside it",
        _MEMORY,
        "if crossings == 2 and width < _FACE:",
        "if False:",
    ),
    Mutant(
        "ends of faces",
        "what goes on inside at one end of a shadow is not there",
        _MEMORY,
        "is_within |= inside[_nearest(rays, bearings)[0]]",
        "pass",
    ),
    Mutant(
        "what hides comes nearer",
        "what has vanished stays where it was seen last",
        _MEMORY,
        "nearest - self._speed * seconds",
        "nearest",
    ),
    Mutant(
        "clearing by what is seen beyond",
        "what is remembered stays although its place is seen through",
        _MEMORY,
        "is_empty = _in_runs(np.isinf(scan.ranges))",
        "is_empty = np.ones(len(scan.ranges), np.bool_)",
    ),
    Mutant(
        "clearing by what is seen outside",
        "what has come out is remembered inside",
        _MEMORY,
        "is_hidden &= ~is_old | (_nearest(out, bearings)[1] > shift)",
        "pass",
    ),
    Mutant(
        "what stands nearby is not what has come out",
        "any return near the rim clears what is remembered beside it",
        _MEMORY,
        "return bearings[_nearest(self._shadows - turned, bearings)[1] <= math.pi / len(is_out)]",
        "return bearings",
    ),
    Mutant(
        "slow turns in memory",
        "what is remembered snaps to the rays",
        _MEMORY,
        "exact[rays[stays]] = bearings[is_hidden][stays]",
        "pass",
    ),
    Mutant(
        "what is left behind",
        "what hid in the open is remembered wherever the robot goes",
        _MEMORY,
        "is_hidden &= bool(np.hypot(*self._from) < _LEFT * self._blind)",
        "pass",
    ),
    Mutant(
        "narrow shadows fade",
        "what cannot be a robot is remembered as long as one",
        _MEMORY,
        "0.0 if crossings or width >= narrow else youngest + seconds",
        "0.0",
    ),
    Mutant(
        "stale stop",
        "a scan is never too old",
        _SENSES,
        "if age > self._stale_after:",
        "if age > 1e9:",
    ),
    Mutant(
        "sweeps that are repeated",
        "the same sweep again is a new one",
        _SCANS,
        "if self._repeats(scan, odometry):",
        "if False:",
    ),
    Mutant(
        "sweeps that lack rays",
        "where no ray goes nothing is",
        _SCANS,
        "and _widest_between(bearings) <= self._most",
        "",
    ),
    Mutant(
        "lost odometry",
        "odometry is never too old",
        _SENSES,
        "return Reason.STALE_ODOMETRY",
        "return None",
    ),
    Mutant(
        "room for late odometry",
        "the robot is where dead reckoning says, however old what it rests on",
        _BARRIER,
        "blurred = (late + self._lag) * self._speed",
        "blurred = self._lag * self._speed",
    ),
    Mutant(
        "room for a sector that lags",
        "what is remembered of a lost sector is where it was last seen",
        _BARRIER,
        "blurred = (late + self._lag) * self._speed",
        "blurred = late * self._speed",
    ),
    Mutant(
        "odometry that restarts",
        "a scan stays where it was placed by a clock that has been set back",
        _MOTION,
        "self.restarts += 1",
        "pass",
    ),
    Mutant(
        "holds",
        "a robot that must not move asks the arbiter",
        _FRONT,
        "if not is_running or hold is not None:",
        "if not is_running:",
    ),
    Mutant(
        "what is not finite",
        "is handed on as it is",
        _FRONT,
        "if decision.twist is not wanted and not decision.twist.is_finite:",
        "if False:",
    ),
    Mutant(
        "ways around are judged",
        "what leads around things passes without protection",
        _FRONT,
        "decision = self._arbiter.decide(asked, moment, command=self._safe, touch=permit.touch)",
        "decision = self._arbiter.decide(wanted, moment, command=self._safe, touch=permit.touch)\n"
        "        if asked is not wanted:\n"
        "            decision = Decision(asked, is_active=True)",
    ),
    Mutant(
        "ways around need a permit",
        "every pattern is led around things",
        _FRONT,
        "if self._unstick is not None and permit.may_unstick:",
        "if self._unstick is not None:",
    ),
    Mutant(
        "sector of a touch zone",
        "a zone is all around",
        _PRESSING,
        "np.abs((off + np.pi) % (2.0 * np.pi) - np.pi) <= zone.half_width",
        "np.abs(off) <= 100.0",
    ),
    Mutant(
        "speed of a touch zone",
        "what is granted is granted at any speed",
        _FRONT,
        "touch=permit.touch)",
        "touch=permit.touch and replace(permit.touch, speed=10.0))",
    ),
    Mutant(
        "clip and project",
        "only the row that is violated most counts",
        "swarmd/protection/feasible.py",
        "for _ in range(len(caps)):",
        "for _ in range(min(len(caps), 1)):",
    ),
)
