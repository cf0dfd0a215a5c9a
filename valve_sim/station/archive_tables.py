"""The tables of archive_node, of topics and of parameters, and what holds between the latter. Needs no ROS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from valve_sim.model import Parameter
from valve_sim.nodes.parameters import Words, check_given, settings_of, table_of
from valve_sim.nodes.topics import Topic
from valve_sim.station.hearing_tables import SAID, check_filled, check_one_each

TOPICS: Final = (
    *SAID,
    Topic(
        "{valve}/serviced", "std_srvs/srv/Trigger", "service", "keep that it was serviced: its strokes count anew",
        qos=None,
    ),
)  # fmt: skip


class ArchiveSettings(NamedTuple):
    """Settings of the node; units as in the table."""

    valves: tuple[str, ...] = ("valve",)
    monitors: tuple[str, ...] = ("monitor",)
    folder: str = "~/.local/share/valve_sim/archive"
    years: float = 10.0
    megabytes: float = 2000.0


PARAMETERS: Final = table_of(
    ArchiveSettings,
    Words("valves", "the valves of which is kept what is said, relative to this node's namespace"),
    Words("monitors", "the monitor of each valve, in the same order"),
    Words("folder", "of the archive"),
    Parameter("years", "years", "that are kept", 0.01, 100.0),
    Parameter("megabytes", "MB", "beyond which the oldest months are taken out", 1.0, 1e6),
)


def archive_settings(given: Mapping[str, object], sources: Mapping[str, str]) -> ArchiveSettings:
    """The settings to start with; arguments and errors as of `check_given`."""
    settings = settings_of(ArchiveSettings, check_given(given, PARAMETERS, sources, "archive_node"))
    check_one_each(settings.valves, monitors=settings.monitors)
    check_filled(folder=settings.folder)
    return settings
