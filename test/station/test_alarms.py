"""The alarm of a valve: raised, seen, gone; and kept whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from valve_sim.model import ValveError
from valve_sim.station.alarms import Alarm, Refusal, load_alarms, save_alarms


def raised() -> Alarm:
    alarm = Alarm().reported(1, "changed", 10.0, "a")
    assert alarm is not None
    return alarm


def seen() -> Alarm:
    alarm = raised().acknowledge("a", "I look", "Ada", 11.0, "b")
    assert isinstance(alarm, Alarm)
    return alarm


def test_an_alarm_is_raised_acknowledged_and_gone() -> None:
    assert (raised().active, raised().acknowledged, raised().severity) == (True, False, 500)
    assert seen().acknowledged and (seen().comment, seen().user, seen().time) == ("I look", "Ada", 11.0)
    gone = seen().reported(0, "as commissioned", 12.0, "c")
    assert gone is not None and not gone.active and not gone.is_retained
    unseen = raised().reported(0, "as commissioned", 12.0, "c")
    assert unseen is not None and unseen.is_retained, "nobody has seen it"


def test_a_report_that_says_nothing_new_is_no_event() -> None:
    assert Alarm().reported(0, "as commissioned", 1.0, "a") is None
    assert raised().reported(1, "changed", 11.0, "b") is None


def test_an_alarm_that_became_worse_is_acknowledged_again_and_a_milder_one_is_not() -> None:
    worse = seen().reported(2, "did not open", 12.0, "c")
    assert worse is not None and not worse.acknowledged and worse.severity == 800 and worse.last_severity == 500
    assert worse.acknowledge("a", "", "", 13.0, "d") is Refusal.UNKNOWN_EVENT, "that event was of the milder alarm"
    again = worse.acknowledge("c", "", "Ada", 13.0, "d")
    assert isinstance(again, Alarm) and again.acknowledge("c", "", "", 13.0, "e") is Refusal.ALREADY_ACKNOWLEDGED
    better = again.reported(1, "changed", 14.0, "e")
    assert better is not None and better.acknowledged


def test_alarms_are_kept_whole_or_refused(tmp_path: Path) -> None:
    path = tmp_path / "alarms.json"
    assert load_alarms(path) == {}
    alarms = {"/tank_1/valve": raised(), "/tank_2/valve": Alarm(), "/tank_3/valve": seen()}
    save_alarms(path, alarms)
    assert load_alarms(path) == alarms
    path.write_text(path.read_text().replace('"user"', '"shelving": "UNSHELVED", "user"'))
    assert load_alarms(path) == alarms, "a file of an earlier version says more"
    path.write_text(path.read_text()[:-30])
    with pytest.raises(ValveError, match="is no file of alarms"):
        load_alarms(path)
    path.write_text('{"schema": "valve_sim/alarms/2", "alarms": {}}')
    with pytest.raises(ValveError, match="schema: found 'valve_sim/alarms/2'"):
        load_alarms(path)
