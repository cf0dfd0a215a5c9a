# ruff: noqa: E501 -- a table of texts and what is said of them
"""The integrator of a user's own equations: closed forms, another integrator, and derivatives by differences."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from plants.rubbing import rubbing_axis

from valve_sim.model.core.hybrid.system import EquationsError
from valve_sim.model.core.own.equations import Equations
from valve_sim.model.core.own.grammar import ExpressionError, parse
from valve_sim.model.core.own.simulation import Inputs, Machine, without_straight
from valve_sim.model.core.own.units import UnitError, dimension_of, parse_unit
from valve_sim.model.errors import SimulationError

Array = NDArray[np.float64]
NO_INPUTS = Inputs(np.empty(0), np.empty((0, 0)), np.empty(0, dtype=bool))
FRICTION = "(f - c*v - (fc + fs*exp(-(v/vs)**2))*sign(v))/m"
NUMBERS = {"m": 1.0, "c": 0.2, "fc": 0.5, "fs": 0.3, "vs": 0.1}
AT_REST = {"x": 0.0, "v": 0.0}


def machine(
    derivatives: dict[str, str], outputs: dict[str, str], inputs: tuple[str, ...] = (), parameters: tuple[str, ...] = ()
) -> Machine:
    read = {name: parse(text) for name, text in derivatives.items()}
    equations = Equations(read, {name: parse(text) for name, text in outputs.items()}, inputs, parameters)
    return Machine(equations, parameters)


def axis() -> Machine:
    return machine({"x": "v", "v": FRICTION}, {"x": "x", "v": "v"}, ("f",), tuple(NUMBERS))


def driven(count: int = 2001) -> tuple[Array, Inputs]:
    times = np.linspace(0.0, 2.0, count)
    force = 1.5 * np.sin(2.0 * np.pi * 0.7 * times)
    return times, Inputs(times, force[:, None], np.array([False]))


def test_an_axis_sticks_and_slips_as_one_of_small_steps_does() -> None:
    times, inputs = driven(401)
    shown, *_ = axis().run(NUMBERS, AT_REST, inputs, times)
    position, velocity = rubbing_axis(times, inputs.levels[:, 0], 1.0, 0.2, 0.5, 0.3)
    assert np.max(np.abs(shown[:, 0] - position)) < 2e-5 * np.ptp(position)
    assert np.max(np.abs(shown[:, 1] - velocity)) < 2e-4 * np.ptp(velocity)
    sticks = np.abs(velocity) < 1e-12
    assert 0.05 < sticks.mean() < 0.9
    assert np.max(np.abs(shown[sticks, 1])) < 1e-3
    assert np.mean(shown[sticks, 1] == 0.0) > 0.9


def test_derivatives_along_many_directions_are_those_along_each() -> None:
    times, inputs = driven(501)
    directions = [{name: 1.0 + 0.1 * k} for k in range(4) for name in (*NUMBERS, "x", "v")]
    together = axis().run(NUMBERS, AT_REST, inputs, times, directions)[1]
    for k in (0, 9, 27):
        alone = axis().run(NUMBERS, AT_REST, inputs, times, [directions[k]])[1]
        assert np.allclose(together[:, :, k], alone[:, :, 0], rtol=1e-9, atol=1e-12)


def test_a_decay_and_an_oscillation_are_those_of_their_formulas() -> None:
    times = np.linspace(0.0, 5.0, 101)
    own = machine({"y": "-y/tau", "x": "v", "v": "-w**2*x"}, {"y": "y", "x": "x"}, (), ("tau", "w"))
    shown, slopes, *_ = own.run({"tau": 0.7, "w": 6.0}, {"y": 2.0, "x": 1.0, "v": 0.0}, NO_INPUTS, times, [{"w": 1.0}])
    assert np.allclose(shown[:, 0], 2.0 * np.exp(-times / 0.7), rtol=1e-7)
    assert np.allclose(shown[:, 1], np.cos(6.0 * times), atol=1e-7)
    assert np.allclose(slopes[:, 1, 0], -times * np.sin(6.0 * times), atol=1e-5)


def test_a_held_input_acts_from_its_sample_on_and_a_straight_one_joins_them() -> None:
    times = np.array([0.0, 1.0, 2.0])
    levels = np.array([[0.0], [2.0], [0.0]])
    own = machine({"x": "u"}, {"x": "x", "u": "u"}, ("u",))
    held, *_ = own.run({}, {"x": 0.0}, Inputs(times, levels, np.array([True])), np.array([0.5, 1.0, 1.5, 2.0, 3.0]))
    assert np.allclose(held, [[0, 0], [0, 2], [1, 2], [2, 0], [2, 0]], atol=1e-12)
    straight, *_ = own.run({}, {"x": 0.0}, Inputs(times, levels, np.array([False])), np.array([0.5, 1.0, 1.5, 3.0]))
    assert np.allclose(straight, [[0.25, 1], [1, 2], [1.75, 1], [2, 0]], atol=1e-12)


def test_a_switch_is_an_event_between_samples() -> None:
    """A tank that overflows above its level: between two samples only an exact event gives the closed form."""
    own = machine({"h": "q - k*max(0, h - top)"}, {"h": "h"}, (), ("q", "k", "top"))
    late = np.array([0.0, 10.0])
    shown, slopes, *_ = own.run({"q": 1.0, "k": 2.0, "top": 0.7}, {"h": 0.0}, NO_INPUTS, late, [{"top": 1.0}])
    assert shown[1, 0] == pytest.approx(0.7 + 0.5 * (1.0 - math.exp(-2.0 * 9.3)), rel=1e-8)
    assert slopes[1, 0, 0] == pytest.approx(1.0 - math.exp(-2.0 * 9.3), abs=1e-7)


def test_a_force_that_is_flat_up_to_a_steep_place_is_not_stepped_over() -> None:
    """A spring that pushes evenly until 10 mm before its middle: what a series foretells, the motion does not do."""
    own = machine({"x": "v", "v": "-k*tanh((x - 1)/w)"}, {"x": "x", "v": "v"}, (), ("k", "w"))
    shown, *_ = own.run({"k": 3.0, "w": 0.01}, {"x": 0.0, "v": 1.0}, NO_INPUTS, np.linspace(0.0, 4.0, 101))
    away = np.abs(shown[:, 0] - 1.0) / 0.01
    energy = 0.5 * shown[:, 1] ** 2 + 0.03 * (away + np.log1p(np.exp(-2.0 * away)))
    assert np.ptp(energy) < 1e-8
    assert np.ptp(shown[:, 0]) > 1.0


def test_friction_by_direction_holds_what_each_direction_holds() -> None:
    own = machine({"v": "(f - where(v > 0, up, -down))/m"}, {"v": "v"}, ("f",), ("m", "up", "down"))
    numbers = {"m": 1.0, "up": 1.0, "down": 3.0}
    for force, speed in ((0.9, 0.0), (-2.9, 0.0), (1.5, 0.5), (-3.5, -0.5)):
        inputs = Inputs(np.array([0.0, 1.0]), np.full((2, 1), force), np.array([True]))
        shown, *_ = own.run(numbers, {"v": 0.0}, inputs, np.array([1.0]))
        assert shown[0, 0] == pytest.approx(speed, abs=1e-12)


def test_what_grows_beyond_bounds_or_has_no_value_ends_with_a_reason() -> None:
    with pytest.raises(SimulationError, match="not finite"):
        machine({"x": "x**2"}, {"x": "x"}).run({}, {"x": 1.0}, NO_INPUTS, np.array([0.0, 2.0]))
    with pytest.raises(SimulationError, match="not finite"):
        machine({"x": "sqrt(x - 5)"}, {"x": "x"}).run({}, {"x": 1.0}, NO_INPUTS, np.array([0.0, 2.0]))


def test_inputs_on_a_line_need_no_corner() -> None:
    times = np.arange(6.0)
    levels = np.array([[0.0], [1.0], [2.0], [3.0], [3.0], [3.0]])
    assert without_straight(Inputs(times, levels, np.array([False]))).times.tolist() == [0.0, 3.0, 5.0]
    assert without_straight(Inputs(times, np.minimum(levels, 1.0), np.array([True]))).times.tolist() == [0.0, 1.0, 5.0]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"), ("2x", "a product is written"), ("a^b", "powers are written"), ("foo(1)", "no function foo"),
        ("sin", "is a function"), ("a > b", "stand first in where"), ("((a", "expected )"), ("x**y", "an exponent is"),
        ("a.b", "letters, digits"), ("__import__('os')", "expected names"), ("where(a, 1, 2)", "expected a comparison"),
        ("min(a)", "expected 2 to 8"), ("(" * 60 + "a" + ")" * 60, "within each other"), ("a+" * 900 + "a", "operations"),
        ("a" * 3000, "characters long"), ("x**99", "from -20 to 20"), ("a b", "expected an operator"), ("+", "expected a number"),
    ],
)  # fmt: skip
def test_what_is_no_expression_is_refused_with_the_mend(text: str, words: str) -> None:
    with pytest.raises(ExpressionError) as caught:
        parse(text)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_units_multiply_and_must_fit() -> None:
    names = {name: parse_unit(text).dimension for name, text in {"f": "N", "c": "N*s/m", "v": "mm/s", "m": "g"}.items()}
    assert dimension_of(parse("(f - c*v)/m"), names) == parse_unit("m/s^2").dimension
    assert dimension_of(parse("max(0, f)"), names) == parse_unit("kg*m/s²").dimension
    assert dimension_of(parse("0"), names) is None
    for text, words in {"f - v": "added to", "exp(f)": "plain number", "where(f > v, 1, 2)": "compared with"}.items():
        with pytest.raises(UnitError, match=words):
            dimension_of(parse(text), names)
    assert parse_unit("mN*m").factor == pytest.approx(1e-3)
    assert parse_unit("deg").factor == pytest.approx(math.pi / 180.0)
    assert parse_unit("N*m*s/rad").si == "N·m·s/rad"
    with pytest.raises(UnitError, match="furlong"):
        parse_unit("furlong")


def test_more_than_there_is_room_for_is_refused() -> None:
    names = tuple(f"v{k}" for k in range(7))
    with pytest.raises(EquationsError, match="stick"):
        machine({name: f"1 - 2*sign({name})" for name in names}, {"v": "v0"})
    many = {f"x{k}": "1" for k in range(13)}
    with pytest.raises(EquationsError, match="found 13 states, expected at most 12"):
        machine(many, {"x": "x0"})
