"""The page of a fleet of 2,000 bags, in a browser."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from identification.browser import CHROMIUM, Browser

from valve_sim.fleet.columns import columns
from valve_sim.fleet.page import write_page
from valve_sim.fleet.units import Row

DAY_NS = 86_400_000_000_000
MEANS = {
    "opening_delay_before": (0.20e-3, 4e-6), "t1_before": (5.3e-3, 10e-6), "t2_before": (9.9e-3, 4e-6),
    "closing_time_before": (12.7e-3, 4e-6), "pilot_damping_before": (1.0, 0.13), "main_damping_before": (4.0, 0.05),
}  # fmt: skip
"""Of a healthy valve: value and standard error."""


def station(bags: int = 2000, valves: int = 20) -> list[Row]:
    """Rows of 100 days: friction grows in two valves, a spring tires in one, and some bags are broken."""
    random = np.random.default_rng(1)
    empty: Row = {column.name: None for column in columns()}
    rows = []
    for number in range(bags):
        valve, share = number % valves, number / bags
        friction, tired = (share if valve in (3, 8) else 0.0), (share if valve == 12 else 0.0)
        values = {name: mean + error * random.standard_normal() for name, (mean, error) in MEANS.items()}
        values["t2_before"] += 0.6e-3 * friction - 0.3e-3 * tired
        values["closing_time_before"] += 1.2e-3 * friction + 0.5e-3 * tired
        is_found = friction > 0.4
        rows.append(
            {
                **empty, **values, **{f"{name}_stderr": error for name, (_, error) in MEANS.items()},
                "source": f"s3://plant/line_{valve}/day_{number // valves:03d}", "valve": f"/line_{valve}/valve",
                "state": "examined", "start_time": 1_760_000_000_000_000_000 + round(100 * share * DAY_NS),
                "verdict": "effects" if is_found else "none", "effects": ["coulomb_friction"] if is_found else [],
                "out_of_tolerance": ["spring_rate"] if tired > 0.8 else [],
                "summary": "The model lacks Coulomb friction." if is_found else "Nothing is missing.",
                "report": f"reports/line-{valve}-{number}/report.html" if is_found else None,
            }
        )  # fmt: skip
    for number in range(3):
        source = f"s3://plant/line_0/broken_{number}.mcap"
        error = f"{source}: is empty (0 bytes), nothing was recorded; record it again"
        rows.append({**empty, "source": source, "valve": "", "state": "unreadable", "error": error})
    return rows


def test_the_three_that_drift_are_named_and_none_of_the_seventeen_others(tmp_path: Path) -> None:
    named = write_page(station(), tmp_path / "fleet.html")
    assert sorted(words.partition(":")[0] for words in named) == ["/line_12/valve", "/line_3/valve", "/line_8/valve"]
    assert (tmp_path / "fleet.html").stat().st_size < 6_000_000


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")
def test_the_page_fits_every_screen_and_unfolds_its_plots(tmp_path: Path) -> None:
    """With VALVE_SIM_SCREENSHOT set to a path, a picture is kept there: `docs/images/fleet.png` is made so."""
    page = tmp_path / "fleet.html"
    write_page(station(), page)
    with Browser(page, tmp_path) as browser:
        for width, scheme in ((390, "dark"), (1120, "light")):
            browser.show(width, scheme=scheme)
            assert browser.evaluate("document.querySelectorAll('.row svg.spark polyline[points]').length") == 20
            browser.evaluate("document.querySelector('.row').open = true")
            while browser.evaluate("document.querySelectorAll('.row figure svg').length") < len(MEANS):
                pass
            assert browser.evaluate("document.querySelectorAll('.row circle').length") == 100 * len(MEANS)
            assert browser.evaluate("document.documentElement.scrollWidth") <= width
            assert browser.evaluate("document.querySelector('a[href]').getAttribute('href')").startswith(
                "reports/line-"
            )
        assert browser.errors == []
        browser.evaluate("setTimeout(() => console.error('seen')); setTimeout(() => { throw 'seen' })")
        while len(browser.errors) < 2:
            browser.evaluate("0")
        picture = tmp_path / "fleet.png"
        browser.screenshot(picture)
        if kept := os.environ.get("VALVE_SIM_SCREENSHOT"):
            shutil.copy(picture, kept)
