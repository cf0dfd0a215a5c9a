"""An effect from an installed package of one file works everywhere, and a broken one is named in one line."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from installed_effect import MAGNET_DRAG, PARAMETERS, Installed

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    return Installed(tmp_path_factory.mktemp("site"), MAGNET_DRAG)


@pytest.fixture(scope="module")
def recording(installed: Installed, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four strokes of a valve that has the effect."""
    folder = tmp_path_factory.mktemp("recording")
    (folder / "valve.yaml").write_text(PARAMETERS)
    lines = [f"{0.01 + 0.03 * i},{volts}" for i, volts in enumerate((9.0, 0.0, 7.5, 0.0, 12.0, 0.0, 14.0, 0.0))]
    (folder / "profile.csv").write_text("\n".join(["time,voltage", *lines]) + "\n")
    bag = folder / "strokes.mcap"
    done = installed.valve_sim(
        "simulate", "--params", folder / "valve.yaml", "--profile", folder / "profile.csv", "--duration", "0.26",
        "--rate", "5000", "--output", bag,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    return bag


def test_it_is_simulated(installed: Installed, tmp_path: Path) -> None:
    openings = []
    for text in (PARAMETERS, PARAMETERS.replace("0.4", "0.0")):
        (tmp_path / "valve.yaml").write_text(text)
        done = installed.valve_sim(
            "simulate", "--params", tmp_path / "valve.yaml", "--voltage", "9", "--duration", "0.03", "--rate", "1e4",
            "--output", tmp_path / "run.csv",
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        with (tmp_path / "run.csv").open() as file:
            rows = list(csv.DictReader(file))
        openings.append(min(float(row["time"]) for row in rows if row["phase"] == "4"))
    assert openings[0] > openings[1] + 0.2e-3


def test_it_is_freed(installed: Installed, recording: Path, tmp_path: Path) -> None:
    done = installed.valve_sim(
        "identify", recording, "--free", "magnet_drag.force,magnet_drag.speed", "--output", tmp_path / "out"
    )
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "out" / "identify.json").read_text())["parameters"]
    assert found["magnet_drag.force"]["value"] == pytest.approx(0.4, rel=0.02)
    assert found["magnet_drag.speed"]["value"] == pytest.approx(0.05, rel=0.02)
    assert "magnet_drag" in (tmp_path / "out" / "identified.yaml").read_text()


def test_it_is_diagnosed(installed: Installed, recording: Path, tmp_path: Path) -> None:
    done = installed.valve_sim("diagnose", recording, "--output", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    best = min(report["candidates"], key=lambda candidate: candidate["delta_bic"])
    assert "magnet_drag" in best["effect"]


def test_a_node_has_its_parameters(installed: Installed) -> None:
    script = (
        "from valve_sim.nodes.valve_parameters import ValveSettings\n"
        "print([name for name in ValveSettings.table() if 'magnet_drag' in name])"
    )
    done = installed.run("-c", script)
    names = [
        f"{group}.magnet_drag.{name}" for group in ("effects", "tolerances.effects") for name in ("force", "speed")
    ]
    assert done.stdout.strip() == str(names), done.stderr


@pytest.mark.parametrize(
    ("source", "target", "words"),
    [
        ("import no_such_module\n", "magnet_drag:EFFECT", ("cannot be loaded", "no_such_module")),
        (MAGNET_DRAG, "magnet_drag:EFFEKT", ("cannot be loaded", "EFFEKT")),
        ("EFFECT = 3\n", "magnet_drag:EFFECT", ("found int", "expected an Effect")),
        (MAGNET_DRAG.replace("term=drag,", ""), "magnet_drag:EFFECT", ("has no expression",)),
        (MAGNET_DRAG.replace('"magnet_drag"', '"coil_lag"'), "magnet_drag:EFFECT", ("coil_lag", "registered already")),
        (MAGNET_DRAG.replace("return -force", "return no_such_name"), "magnet_drag:EFFECT", ("cannot be compiled",)),
    ],
    ids=["no module", "no attribute", "no effect", "no term", "name taken", "does not compile"],
)
def test_a_broken_one_is_named_in_one_line(tmp_path: Path, source: str, target: str, words: tuple[str, ...]) -> None:
    (tmp_path / "valve.yaml").write_text(PARAMETERS)
    done = Installed(tmp_path / "site", source, target).valve_sim(
        "simulate", "--params", tmp_path / "valve.yaml", "--voltage", "9", "--duration", "0.01", "--rate", "1000",
        "--output", tmp_path / "run.csv",
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    # A first line may say that the model is being compiled.
    (line,) = [said for said in done.stderr.strip().splitlines() if not said.startswith("valve-sim: compiling")]
    assert all(word in line for word in (f"entry point magnet_drag = {target}", "magnet-drag", *words)), line
    assert not (tmp_path / "run.csv").exists()


def test_a_changed_term_is_compiled_anew(tmp_path: Path) -> None:
    site = Installed(tmp_path / "site", MAGNET_DRAG)
    script = (
        "from valve_sim.model import Drive, Valve, simulate\n"
        "valve = Valve(Valve().with_values(a0=3.0).parameters, {'magnet_drag': {'force': 0.4, 'speed': 0.05}})\n"
        "print(simulate(valve, Drive.of([0.0], [9.0]), [5e-3]).pilot_position[0])"
    )
    before = float(site.run("-c", script).stdout)
    # Of another length: Python takes a file for unchanged that has the same size and is of the same second.
    (tmp_path / "site" / "magnet_drag.py").write_text(MAGNET_DRAG.replace("2.0 * v", "3.00 * v"))
    after = float(site.run("-c", script).stdout)
    assert np.isfinite([before, after]).all()
    assert after < 0.99 * before
