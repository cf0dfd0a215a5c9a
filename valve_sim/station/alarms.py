"""The alarm of one valve: active, acknowledged; plain data, without OPC UA.

An alarm becomes active when the monitor of its valve says WARN or ERROR. A person acknowledges that it was seen. It is
retained until it is inactive and acknowledged.
"""

from __future__ import annotations

import enum
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Final

from valve_sim.files.whole_files import write_whole
from valve_sim.model.errors import ValveError

SEVERITIES: Final = {0: 1, 1: 500, 2: 800, 3: 300}
"""Severity in OPC UA, 1 to 1000, of each level of a diagnostic status: OK, WARN, ERROR, STALE."""
_ALARMING: Final = (1, 2)
_MOST_EVENTS: Final = 32
"""Events of one occurrence by which it can be acknowledged: a client may hold an older one than the last."""
_SCHEMA: Final = "valve_sim/alarms/1"


class Refusal(enum.Enum):
    """Why an acknowledgement does not count; the value is the status code's name in OPC UA."""

    UNKNOWN_EVENT = "BadEventIdUnknown"
    ALREADY_ACKNOWLEDGED = "BadConditionBranchAlreadyAcked"


@dataclass(frozen=True)
class Alarm:
    """The state of one alarm.

    Attributes:
        active: whether something is wrong with the valve now. acknowledged: whether a person has seen it.
        level: of the last report. severity, last_severity: of now and of before, 1 to 1000.
        message: of the last report. comment, user: of the person who acknowledged.
        time: of the last change, s since 1970. event: of the last change. events: of this occurrence, the last 32.
    """

    active: bool = False
    acknowledged: bool = True
    level: int = 0
    severity: int = SEVERITIES[0]
    last_severity: int = SEVERITIES[0]
    message: str = ""
    comment: str = ""
    user: str = ""
    time: float = 0.0
    event: str = ""
    events: tuple[str, ...] = ()

    @property
    def is_retained(self) -> bool:
        """Whether a client that asks for what is of interest is shown it."""
        return self.active or not self.acknowledged

    def reported(self, level: int, message: str, time: float, event: str) -> Alarm | None:
        """The alarm after a report of the monitor, at a time in s since 1970; None where it says nothing new.

        Args:
            level: as in a diagnostic status. event: identity that the change gets.
        """
        is_active = level in _ALARMING
        if not is_active and not self.active:
            return None
        if is_active and self.active and (level, message) == (self.level, self.message):
            return None
        severity = SEVERITIES.get(level, SEVERITIES[3])
        changed = replace(
            self, active=is_active, level=level, severity=severity, last_severity=self.severity, message=message
        )
        if is_active and (not self.active or severity > self.severity):
            # A person has seen the milder alarm only.
            changed = replace(changed, acknowledged=False, comment="", user="", events=())
        return changed._at(time, event)

    def acknowledge(self, seen: str, comment: str, user: str, time: float, event: str) -> Alarm | Refusal:
        """The alarm after a person has seen one of its events; or why that does not count.

        Args:
            seen: identity of the event that was seen. event: identity that the change gets.
        """
        if seen not in self.events:
            return Refusal.UNKNOWN_EVENT
        if self.acknowledged:
            return Refusal.ALREADY_ACKNOWLEDGED
        return replace(self, acknowledged=True, comment=comment, user=user)._at(time, event)

    def _at(self, time: float, event: str) -> Alarm:
        return replace(self, time=time, event=event, events=(*self.events, event)[-_MOST_EVENTS:])


def save_alarms(path: Path, alarms: Mapping[str, Alarm]) -> None:
    """Write alarms by valve, whole or not at all.

    Raises:
        ValveError: the file cannot be written.
    """
    content = {"schema": _SCHEMA, "alarms": {valve: asdict(alarm) for valve, alarm in alarms.items()}}
    write_whole(path, json.dumps(content, indent=1, ensure_ascii=False) + "\n")


def load_alarms(path: Path) -> dict[str, Alarm]:
    """The alarms of a file that `save_alarms` wrote; none where there is no file.

    Raises:
        ValveError: the file cannot be read, or is another one.
    """
    if not path.exists():
        return {}
    mend = "restore it from a backup, or delete it: active alarms are then raised again"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["schema"] != _SCHEMA:
            raise ValveError(f"{path}: schema: found {content['schema']!r}, expected {_SCHEMA}; {mend}")
        return {valve: _alarm(found) for valve, found in content["alarms"].items()}
    except OSError as error:
        raise ValveError(f"{path}: cannot be read ({error.strerror}); {mend}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValveError(f"{path}: is no file of alarms ({' '.join(str(error).split())}); {mend}") from error


def _alarm(found: Mapping[str, Any]) -> Alarm:
    return Alarm(**{entry.name: found[entry.name] for entry in fields(Alarm)} | {"events": tuple(found["events"])})
