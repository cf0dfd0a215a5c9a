"""The alarm of a valve: raised, seen, dealt with, gone; and kept whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from valve_sim.model import ValveError
from valve_sim.station.alarms import Alarm, Refusal, load_alarms, save_alarms


def raised() -> Alarm:
    alarm = Alarm().reported(1, "changed", 10.0, "a")
    assert alarm is not None
    return alarm


def test_an_alarm_is_raised_acknowledged_confirmed_and_gone() -> None:
    alarm = raised()
    assert (alarm.active, alarm.acknowledged, alarm.confirmed, alarm.severity) == (True, False, False, 500)
    seen = alarm.acknowledge("a", "I look", "Ada", 11.0, "b")
    assert isinstance(seen, Alarm) and seen.acknowledged and not seen.confirmed
    assert (seen.comment, seen.user, seen.time) == ("I look", "Ada", 11.0)
    gone = seen.reported(0, "as commissioned", 12.0, "c")
    assert gone is not None and not gone.active and gone.is_retained, "nobody has confirmed it"
    done = gone.confirm("a", "", "Bob", 13.0, "d")
    assert isinstance(done, Alarm) and not done.is_retained
    assert (done.comment, done.user) == ("I look", "Bob")


def test_what_says_nothing_new_is_no_event() -> None:
    assert Alarm().reported(0, "as commissioned", 1.0, "a") is None
    assert raised().reported(1, "changed", 11.0, "b") is None
    other_words = raised().reported(1, "changed: friction", 11.0, "b")
    assert other_words is not None and other_words.events == ("a", "b")


def test_what_became_worse_is_to_be_seen_anew_and_what_became_better_is_not() -> None:
    seen = raised().acknowledge("a", "known", "Ada", 11.0, "b")
    assert isinstance(seen, Alarm)
    worse = seen.reported(2, "did not open", 12.0, "c")
    assert worse is not None and not worse.acknowledged and worse.severity == 800 and worse.last_severity == 500
    assert worse.acknowledge("a", "", "", 13.0, "d") is Refusal.UNKNOWN_EVENT, "that event was of the milder alarm"
    again = worse.acknowledge("c", "", "Ada", 13.0, "d")
    assert isinstance(again, Alarm)
    better = again.reported(1, "changed", 14.0, "e")
    assert better is not None and better.acknowledged


def test_answers_that_do_not_count_say_why() -> None:
    alarm = raised()
    assert alarm.acknowledge("x", "", "", 11.0, "b") is Refusal.UNKNOWN_EVENT
    assert alarm.confirm("a", "", "", 11.0, "b") is Refusal.NOT_ACKNOWLEDGED
    seen = alarm.acknowledge("a", "", "", 11.0, "b")
    assert isinstance(seen, Alarm)
    assert seen.acknowledge("b", "", "", 12.0, "c") is Refusal.ALREADY_ACKNOWLEDGED
    done = seen.confirm("b", "", "", 12.0, "c")
    assert isinstance(done, Alarm)
    assert done.confirm("c", "", "", 13.0, "d") is Refusal.ALREADY_CONFIRMED
    noted = done.commented("c", "spring ordered", "Ada", 14.0, "e")
    assert isinstance(noted, Alarm) and noted.comment == "spring ordered"


def test_the_events_of_an_occurrence_are_bounded() -> None:
    alarm = raised()
    for count in range(100):
        changed = alarm.reported(1, f"{count}", 11.0 + count, f"e{count}")
        assert changed is not None
        alarm = changed
    assert len(alarm.events) == 32 and alarm.events[-1] == alarm.event


def test_alarms_are_kept_whole_or_refused(tmp_path: Path) -> None:
    path = tmp_path / "alarms.json"
    assert load_alarms(path) == {}
    save_alarms(path, {"/tank_1/valve": raised(), "/tank_2/valve": Alarm()})
    assert load_alarms(path) == {"/tank_1/valve": raised(), "/tank_2/valve": Alarm()}
    path.write_text(path.read_text()[:-30])
    with pytest.raises(ValveError, match="is no file of alarms"):
        load_alarms(path)
    path.write_text('{"schema": "valve_sim/alarms/2", "alarms": {}}')
    with pytest.raises(ValveError, match="schema: found 'valve_sim/alarms/2'"):
        load_alarms(path)
