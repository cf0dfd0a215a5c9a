"""Files that ship beside the code are found however it was installed."""

from pathlib import Path

import pytest

from valve_sim.files import resources
from valve_sim.model.errors import ValveError

INSTALLED_CODE = ("lib/python3.12/site-packages/valve_sim", "local/lib/python3.12/dist-packages/valve_sim", "valve_sim")
"""By colcon or pip, by Debian's pip, by pip --target."""


def place(file: Path) -> Path:
    """Make an empty file and the folders above it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.touch()
    return file


@pytest.fixture
def code_at(monkeypatch: pytest.MonkeyPatch):
    return lambda file: monkeypatch.setattr(resources, "__file__", str(file))


@pytest.mark.parametrize("folder", INSTALLED_CODE)
def test_an_installation_reads_its_own_share(tmp_path, code_at, folder):
    code_at(place(tmp_path / "prefix" / folder / "files/resources.py"))
    shipped = place(tmp_path / "prefix/share/valve_sim/config/valve.yaml")
    place(tmp_path / "share/valve_sim/config/valve.yaml")
    assert resources.config_path("valve.yaml") == shipped


def test_a_checkout_reads_its_own_config_not_an_installation_around_it(tmp_path, code_at):
    code_at(place(tmp_path / "checkout/valve_sim/files/resources.py"))
    place(tmp_path / "checkout/package.xml")
    shipped = place(tmp_path / "checkout/config/valve.yaml")
    place(tmp_path / "share/valve_sim/config/valve.yaml")
    assert resources.config_path("valve.yaml") == shipped


def test_an_unknown_name_is_answered_with_those_that_ship(tmp_path, code_at):
    code_at(place(tmp_path / "valve_sim/files/resources.py"))
    place(tmp_path / "share/valve_sim/config/valve.yaml")
    with pytest.raises(ValveError, match=r"^vavle\.yaml: no such file.* valve\.yaml"):
        resources.config_path("vavle.yaml")


def test_an_installation_without_its_share_folder_is_named(tmp_path, code_at):
    code = place(tmp_path / "valve_sim/files/resources.py")
    code_at(code)
    with pytest.raises(ValveError, match=f"{code}; install"):
        resources.config_path("valve.yaml")
