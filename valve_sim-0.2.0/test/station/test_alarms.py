"""The alarm of a valve: raised, seen, dealt with, gone; and kept whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from valve_sim.model import ValveError
from valve_sim.station.alarms import LONGEST_SHELVED, Alarm, Refusal, Shelving, load_alarms, save_alarms


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


def test_an_alarm_is_shelved_for_a_time() -> None:
    shelved = raised().shelve(60.0, "Ada", 11.0, "b")
    assert isinstance(shelved, Alarm) and shelved.is_shelved
    assert (shelved.shelved_until, shelved.user, shelved.event, shelved.active) == (71.0, "Ada", "b", True)
    assert shelved.shelve(60.0, "Ada", 12.0, "c") is Refusal.ALREADY_SHELVED
    worse = shelved.reported(2, "did not open", 20.0, "c")
    assert worse is not None and worse.is_shelved and not worse.acknowledged
    assert shelved.expired(70.9, "c") is None
    over = shelved.expired(71.0, "c")
    assert over is not None and not over.is_shelved and over.active and over.expired(72.0, "d") is None
    gone = shelved.reported(0, "as commissioned", 20.0, "c")
    assert gone is not None and gone.is_shelved, "it is shelved for a time, whatever happens meanwhile"


def test_an_alarm_is_shelved_until_it_is_inactive_or_a_person_takes_it_back() -> None:
    shelved = raised().shelve(None, "Ada", 11.0, "b")
    assert isinstance(shelved, Alarm) and shelved.shelving is Shelving.ONE_SHOT
    assert shelved.shelve(None, "Ada", 12.0, "c") is Refusal.ALREADY_SHELVED
    assert shelved.expired(1e12, "c") is None
    gone = shelved.reported(0, "as commissioned", 12.0, "c")
    assert gone is not None and not gone.is_shelved
    back = shelved.unshelve("Bob", 12.0, "c")
    assert isinstance(back, Alarm) and not back.is_shelved and back.user == "Bob"
    assert back.unshelve("Bob", 13.0, "d") is Refusal.NOT_SHELVED


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan"), 2 * LONGEST_SHELVED])
def test_a_time_that_is_none_shelves_nothing(seconds: float) -> None:
    assert raised().shelve(seconds, "Ada", 11.0, "b") is Refusal.TIME_OUT_OF_RANGE


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
    shelved = raised().shelve(60.0, "Ada", 11.0, "b")
    assert isinstance(shelved, Alarm)
    alarms = {"/tank_1/valve": raised(), "/tank_2/valve": Alarm(), "/tank_3/valve": shelved}
    save_alarms(path, alarms)
    assert load_alarms(path) == alarms
    path.write_text(path.read_text()[:-30])
    with pytest.raises(ValveError, match="is no file of alarms"):
        load_alarms(path)
    path.write_text('{"schema": "valve_sim/alarms/2", "alarms": {}}')
    with pytest.raises(ValveError, match="schema: found 'valve_sim/alarms/2'"):
        load_alarms(path)
