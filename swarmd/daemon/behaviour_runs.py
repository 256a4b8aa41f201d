"""Which pushed code a pattern host loads, how long it ran, and the return from it after a fault."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from msgspec.structs import replace

from swarmd.core.behaviour import read_entry
from swarmd.core.errors import ChangedCodeError
from swarmd.core.host_messages import HostEvent, Load, Loaded
from swarmd.daemon.behaviour_state import BehaviourState
from swarmd.plugins import Origin
from swarmd.robot.actions import FailedCode
from swarmd.robot.pushed_code import Version

MAX_LOADS = 8  # loads of which the code is known


@dataclass(frozen=True, slots=True)
class LoadedCode:
    """The pushed code that a pattern host has loaded."""

    name: str
    digest: bytes


class CodeRuns:
    """The runs of the pushed code in `state`."""

    def __init__(self, state: BehaviourState) -> None:
        self._state = state
        self._loads: dict[int, LoadedCode] = {}
        self._ran_to: tuple[int, float] = (-1, 0.0)  # generation, time

    def overlay(
        self, found: Mapping[str, Origin], load: Load, is_trial: bool
    ) -> Mapping[str, Origin]:
        """The patterns for a load: the robot's own, and what was pushed.

        A restart takes the code that the run began with; a trial takes the candidate. Raises
        ChangedCodeError if the code of the pattern is damaged: nothing else of that name is loaded.
        """
        origins = dict(found)
        candidate = self._state.candidate if is_trial else None
        for name, code in self._state.versions.items():
            version = code.current
            if load.is_restart and not is_trial:
                version = self._state.pinned.get(name, version)
            if version is None and code.is_damaged:
                if name == load.pattern and candidate is None:
                    raise ChangedCodeError(f"{code.fault}; push it again")
                origins.pop(name, None)
            if version is None or not self._lay(origins, name, version, found):
                continue
            if not is_trial:
                self._note_load(load, name, version)
        if candidate is not None:
            self._lay(origins, load.pattern, candidate.version, found)
        return origins

    def _lay(
        self,
        origins: dict[str, Origin],
        name: str,
        version: Version,
        own: Mapping[str, Origin],
    ) -> bool:
        """Add a version to the origins; False if the robot's own pattern counts."""
        manifest = read_entry(version.signed).manifest
        if name in own and not manifest.replaces:
            return False
        value, is_file = self._state.files.place(manifest)
        source = f"{manifest.label} of {manifest.issuer}"
        origins[name] = Origin(value, source, is_file, digest=manifest.digest)
        return True

    def _note_load(self, load: Load, name: str, version: Version) -> None:
        state = self._state
        state.pinned[name] = version
        if name != load.pattern:
            return
        self._loads[load.generation] = LoadedCode(name, version.digest)
        while len(self._loads) > MAX_LOADS:
            del self._loads[next(iter(self._loads))]
        if self.is_provisional(load.generation) and not state.versions[name].is_running:
            state.versions[name] = state.versions[name].begin()
            state.save()

    def is_provisional(self, generation: int) -> bool:
        """True if the load of that generation has the current version, and that is provisional."""
        loaded = self._loads.get(generation)
        code = None if loaded is None else self._state.versions.get(loaded.name)
        if loaded is None or code is None or code.current is None:
            return False
        return code.is_provisional and code.current.digest == loaded.digest

    def granted(self, event: HostEvent) -> HostEvent:
        """An event of the pattern host without what pushed code may not ask.

        It may not go on with scans that hold other patterns: no configuration grants that by name.
        """
        if isinstance(event, Loaded) and event.scan_delay and event.generation in self._loads:
            text = "its `scan_delay` does not count, since it was pushed"
            note = f"{event.note}; {text}" if event.note else text
            return replace(event, scan_delay=0.0, note=note)
        return event

    def on_failed(self, failed: FailedCode) -> None:
        """Provisional code has failed: return to the version before. The robot stands already."""
        loaded = self._loads.get(failed.generation)
        if loaded is None or not self.is_provisional(failed.generation):
            return
        code = self._state.versions[loaded.name] = self._state.versions[loaded.name].failed_with(
            failed.text
        )
        self._state.pinned.pop(loaded.name, None)
        self._state.save()
        self._state.tell_of_return(loaded.name, code)

    def advance(self, now: float, generation: int | None, *, is_running: bool) -> None:
        """Time passes; `generation`: of the pattern that runs or is being loaded."""
        last, at = self._ran_to
        running = generation if is_running else None
        self._ran_to = (-1 if running is None else running), now
        loaded = None if generation is None else self._loads.get(generation)
        for name, code in list(self._state.versions.items()):
            is_this = loaded is not None and loaded.name == name
            if code.is_running and not is_this:
                self._state.versions[name] = code.end()
                self._state.save()
            elif is_this and running == last and self.is_provisional(last):
                self._state.versions[name] = ran = code.ran(now - at)
                if not ran.is_provisional:
                    self._state.save()
                    assert ran.current is not None
                    self._state.control.event(f"{ran.current.label} is held")
