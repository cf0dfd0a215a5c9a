"""The table of statements names tests that exist, and some statements that no other test holds."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from recordings.bag_makers import COMMANDS, clean_trace

from valve_sim.cli import main
from valve_sim.recordings import describe

TESTS = Path(__file__).parent
PAGE = TESTS.parent / "docs" / "reference" / "statements.md"


def test_every_statement_names_a_test_that_exists_or_none() -> None:
    rows = [line.split("|")[-2].strip() for line in PAGE.read_text(encoding="utf-8").splitlines() if line[:1] == "|"]
    named = [row for row in rows if row not in ("test", "---", "none")]
    assert len(named) > 60
    for row in named:
        place, _, name = row.strip("`").partition("::")
        text = (TESTS / place).read_text(encoding="utf-8")
        assert not name or re.search(rf"^(async )?def {name}\(", text, re.MULTILINE), row


def test_info_tells_duration_jitter_and_commands() -> None:
    trace, random = clean_trace(), np.random.default_rng(1)
    times = trace.times + random.uniform(-20e-6, 20e-6, len(trace.times))
    summary = describe(replace(trace, times=times, main_position=None))
    assert summary.duration == pytest.approx(times[-1] - times[0], abs=1e-12)
    intervals = np.abs(np.diff(times) - np.median(np.diff(times)))
    assert np.mean(intervals <= summary.jitter) == pytest.approx(0.99, abs=2e-3)
    assert (summary.commands, summary.voltages) == (len(COMMANDS), (0.0, 9.0))
    assert summary.position_range == (trace.pilot_position.min(), trace.pilot_position.max())


def test_fit_force_tells_the_residual_and_r_squared_of_its_polynomial(tmp_path: Path) -> None:
    displacement = np.linspace(0.0, 1.23e-3, 40)
    force = 3.0 + 1.7e4 * displacement + np.random.default_rng(2).normal(0.0, 0.05, 40)
    with (tmp_path / "force.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows([("displacement", "force"), *zip(displacement, force, strict=True)])
    ran = CliRunner().invoke(main, ["fit-force", str(tmp_path / "force.csv"), "--output", str(tmp_path), "--json"])
    assert ran.exit_code == 0, ran.output
    told = json.loads(ran.stdout)
    left = force - np.polyval(told["attraction_polynomial"][::-1], displacement)
    assert told["rmse_n"] == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-6)
    assert told["maximum_n"] == pytest.approx(np.abs(left).max(), rel=1e-6)
    assert told["r_squared"] == pytest.approx(1.0 - np.var(left) / np.var(force), rel=1e-6)
