"""The alarm of one valve as OPC UA has it (Part 9): active, acknowledged, confirmed; plain data, without OPC UA.

An alarm becomes active when the monitor of its valve says WARN or ERROR. A person acknowledges that it was seen and
confirms that it was dealt with; it is shown (retained) until it is inactive, acknowledged and confirmed. A person may
shelve it, for a time or until it is inactive: it is then known, and clients do not ask for attention.
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
"""Events of one occurrence by which it can be acknowledged: a client may hold one that is not the last."""
LONGEST_SHELVED: Final = 30 * 86400.0
"""s that an alarm may be shelved: what is to be ignored for longer is to be repaired, or commissioned anew."""
_SCHEMA: Final = "valve_sim/alarms/1"


class Refusal(enum.Enum):
    """Why a person's answer to an alarm does not count; the value is the status code's name in OPC UA."""

    UNKNOWN_EVENT = "BadEventIdUnknown"
    ALREADY_ACKNOWLEDGED = "BadConditionBranchAlreadyAcked"
    NOT_ACKNOWLEDGED = "BadInvalidState"
    ALREADY_CONFIRMED = "BadConditionBranchAlreadyConfirmed"
    ALREADY_SHELVED = "BadConditionAlreadyShelved"
    NOT_SHELVED = "BadConditionNotShelved"
    TIME_OUT_OF_RANGE = "BadShelvingTimeOutOfRange"


class Shelving(enum.Enum):
    """Whether an alarm is shelved, as OPC UA names it; the value is the state's number."""

    UNSHELVED = 1
    TIMED = 2
    ONE_SHOT = 3


@dataclass(frozen=True)
class Alarm:
    """The state of one alarm.

    Attributes:
        active: whether the valve is not as it should be now. acknowledged, confirmed: whether a person has said so.
        level: of the last report. severity, last_severity: of now and of before, 1 to 1000.
        message: of the last report. comment, user: of the person who answered last.
        time: of the last change, s since 1970. event: of the last change. events: of this occurrence, the last 32.
        shelving: whether a person has shelved it. shelved_until: s since 1970; 0 where that is not for a time.
    """

    active: bool = False
    acknowledged: bool = True
    confirmed: bool = True
    level: int = 0
    severity: int = SEVERITIES[0]
    last_severity: int = SEVERITIES[0]
    message: str = ""
    comment: str = ""
    user: str = ""
    time: float = 0.0
    event: str = ""
    events: tuple[str, ...] = ()
    shelving: Shelving = Shelving.UNSHELVED
    shelved_until: float = 0.0

    @property
    def is_shelved(self) -> bool:
        """Whether clients are not to ask for attention."""
        return self.shelving is not Shelving.UNSHELVED

    @property
    def is_retained(self) -> bool:
        """Whether a client that asks for what is of interest is shown it."""
        return self.active or not self.acknowledged or not self.confirmed

    def reported(self, level: int, message: str, time: float, event: str) -> Alarm | None:
        """The alarm after a report of the monitor; None where the report says nothing new.

        Args:
            level: of the report, as in a diagnostic status. message: of it. time: of it, s since 1970.
            event: identity that the change gets.
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
            # What has become worse than what a person has seen is to be seen anew.
            changed = replace(changed, acknowledged=False, confirmed=False, comment="", user="", events=())
        if not is_active and self.shelving is Shelving.ONE_SHOT:
            changed = replace(changed, shelving=Shelving.UNSHELVED)
        return changed._at(time, event)

    def acknowledge(self, seen: str, comment: str, user: str, time: float, event: str) -> Alarm | Refusal:
        """The alarm after a person has seen one of its events; or why that does not count.

        Args:
            seen: identity of the event that was seen. comment: of the person, kept if it is not empty. user: who it is.
            time: s since 1970. event: identity that the change gets.
        """
        if seen not in self.events:
            return Refusal.UNKNOWN_EVENT
        if self.acknowledged:
            return Refusal.ALREADY_ACKNOWLEDGED
        return replace(self, acknowledged=True, comment=comment or self.comment, user=user)._at(time, event)

    def confirm(self, seen: str, comment: str, user: str, time: float, event: str) -> Alarm | Refusal:
        """The alarm after a person has dealt with it; or why that does not count; as `acknowledge`."""
        if seen not in self.events:
            return Refusal.UNKNOWN_EVENT
        if not self.acknowledged:
            return Refusal.NOT_ACKNOWLEDGED
        if self.confirmed:
            return Refusal.ALREADY_CONFIRMED
        return replace(self, confirmed=True, comment=comment or self.comment, user=user)._at(time, event)

    def commented(self, seen: str, comment: str, user: str, time: float, event: str) -> Alarm | Refusal:
        """The alarm with another comment; or why that does not count; as `acknowledge`."""
        if seen not in self.events:
            return Refusal.UNKNOWN_EVENT
        return replace(self, comment=comment, user=user)._at(time, event)

    def shelve(self, seconds: float | None, user: str, time: float, event: str) -> Alarm | Refusal:
        """The alarm after a person has shelved it; or why that does not count.

        Args:
            seconds: for which; None: until it is inactive. user, time, event: as `acknowledge`.
        """
        if seconds is None:
            if self.shelving is Shelving.ONE_SHOT:
                return Refusal.ALREADY_SHELVED
            return replace(self, shelving=Shelving.ONE_SHOT, shelved_until=0.0, user=user)._at(time, event)
        if self.shelving is Shelving.TIMED:
            return Refusal.ALREADY_SHELVED
        if not 0.0 < seconds <= LONGEST_SHELVED:
            return Refusal.TIME_OUT_OF_RANGE
        return replace(self, shelving=Shelving.TIMED, shelved_until=time + seconds, user=user)._at(time, event)

    def unshelve(self, user: str, time: float, event: str) -> Alarm | Refusal:
        """The alarm after a person has taken it from the shelf; or why that does not count; as `acknowledge`."""
        if not self.is_shelved:
            return Refusal.NOT_SHELVED
        return replace(self, shelving=Shelving.UNSHELVED, shelved_until=0.0, user=user)._at(time, event)

    def expired(self, time: float, event: str) -> Alarm | None:
        """The alarm once the time for which it was shelved is over; None where it is not."""
        if self.shelving is not Shelving.TIMED or time < self.shelved_until:
            return None
        return replace(self, shelving=Shelving.UNSHELVED, shelved_until=0.0)._at(time, event)

    def _at(self, time: float, event: str) -> Alarm:
        return replace(self, time=time, event=event, events=(*self.events, event)[-_MOST_EVENTS:])


def save_alarms(path: Path, alarms: Mapping[str, Alarm]) -> None:
    """Write alarms by valve, whole or not at all.

    Raises:
        ValveError: the file cannot be written.
    """
    found = {valve: {**asdict(alarm), "shelving": alarm.shelving.name} for valve, alarm in alarms.items()}
    content = {"schema": _SCHEMA, "alarms": found}
    write_whole(path, json.dumps(content, indent=1, ensure_ascii=False) + "\n")


def load_alarms(path: Path) -> dict[str, Alarm]:
    """The alarms of a file that `save_alarms` wrote; none where there is no file.

    Raises:
        ValveError: the file cannot be read, or is another one.
    """
    if not path.exists():
        return {}
    mend = "restore it from a backup, or delete it: alarms that are active are then raised anew"
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
    known = {entry.name for entry in fields(Alarm)}
    values = {name: value for name, value in found.items() if name in known}
    shelving = Shelving[found.get("shelving", Shelving.UNSHELVED.name)]
    return Alarm(**{**values, "events": tuple(found["events"]), "shelving": shelving})
