"""What handing parameters on says, without a node."""

from __future__ import annotations

import math

import pytest

pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")

from valve_sim.identification.estimation.intervals import Interval
from valve_sim.nodes.identification import changes_between


def test_changes_have_units_and_digits_that_show_the_interval() -> None:
    old = {
        "valve.pilot_damping": 1.0,
        "valve.stroke": 1.23e-3,
        "valve.attraction_polynomial": [0.0, 17096.0],
        "effects.coulomb_friction.force": 0.0,
        "effects.sensor_bandwidth.cutoff_frequency": math.inf,
    }
    new = {
        **old,
        "valve.pilot_damping": 1.2999987,
        "valve.attraction_polynomial": [3.0, 17096.0],
        "effects.coulomb_friction.force": 0.3,
        "effects.sensor_bandwidth.cutoff_frequency": 2000.0,
    }
    intervals = {
        "pilot_damping": Interval(1.2999987, 1e-6, 1.2999967, 1.3000007),
        "coulomb_friction.force": Interval(0.3, math.nan, 0.0, math.inf),
    }
    assert [change.text() for change in changes_between(old, new, intervals)] == [
        "valve.pilot_damping: 1 → 1.2999987 N·s/m, 95 % interval 1.2999967 to 1.3000007",
        "valve.attraction_polynomial: [0, 17096] → [3, 17096]",
        "effects.coulomb_friction.force: 0 → 0.3 N, 95 % interval 0 to infinity",
        "effects.sensor_bandwidth.cutoff_frequency: infinity → 2000 Hz",
    ]


def test_each_tolerance_that_changes_has_a_line_of_its_own() -> None:
    old = {"tolerances": '{"stroke": 4e-06, "spring_rate": 12.8, "pilot_mass": 0.0005}'}
    new = {"tolerances": '{"stroke": 2e-06, "spring_rate": 12.8, "effects": {"stiction": {"force": 0.01}}}'}
    assert {change.text() for change in changes_between(old, new, {})} == {
        "tolerances.stroke: 4e-06 → 2e-06 m",
        "tolerances.effects.stiction.force: 0 → 0.01 N",
        "tolerances.pilot_mass: 0.0005 → 0 kg",
    }
