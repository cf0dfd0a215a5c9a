"""The ROS side of plc_node: a `PlcStation` wired to the topics of its valves. The coils are off at its end.

Threads: the main one takes what was heard, looks at the watchdogs and repeats the commands; Modbus has one of its own,
which also publishes a command that the PLC has just switched. Watchdogs go by the machine's own clock, also under
use_sim_time: a /clock that stands still must not keep a coil energised.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from rclpy.publisher import Publisher
from std_msgs.msg import Float64

from valve_sim.files.parameter_sections import Section
from valve_sim.files.whole_files import write_whole
from valve_sim.nodes.realtime import Arrival
from valve_sim.nodes.receiving import Inbox
from valve_sim.nodes.spinning import wait_until_heard
from valve_sim.nodes.starting import Extra
from valve_sim.nodes.wiring import RosNode
from valve_sim.station.hearing import hear_live
from valve_sim.station.loop_thread import LoopThread, Served
from valve_sim.station.modbus import PlcServer
from valve_sim.station.plc import PlcStation, map_csv
from valve_sim.station.tables import PLC_TOPICS, PlcSettings

_BETWEEN_COMMANDS: Final = 0.05
"""s between repetitions of a command that has not changed: a valve whose command_timeout is 0.1 s stays as it is."""
_BETWEEN_COUNTS: Final = 1.0
"""s between looks for others that command the same valve."""
_BETWEEN_SIGNS: Final = 0.2
"""s between looks at the currents of the valves, which only tell that they live."""


class PlcNode(RosNode[PlcSettings]):
    """The node `plc`, with the topics `tables.PLC_TOPICS` of each of `valves`.

    Parameters: `tables.PlcSettings`; they are read once, at the start.

    Raises:
        ValveError: a parameter cannot be used, or the port is taken.
    """

    def __init__(self, sections: Sequence[tuple[str, Section]]) -> None:
        super().__init__("plc", sections, PlcSettings, PLC_TOPICS)
        settings = self._settings
        self._valves = self._full_names("valves")
        self._inbox, self._signs = (Inbox(self._node, self._clock) for _ in range(2))
        self._was_on = [False] * len(self._valves)
        self._commands: list[Publisher] = []
        self._voltages: list[Publisher] = []
        """Those of `_commands` that have published."""
        self._commanding = threading.Lock()
        self._is_off = False
        """Whether 0 V has been commanded for good; whoever is still at work then commands nothing."""
        self._others: set[str] = set()
        self._station = PlcStation(
            self._valves, settings.watchdog, changed=self._command, low_word_first=settings.low_word_first
        )
        self._wire()
        if settings.map_file:
            write_whole(Path(settings.map_file).expanduser(), map_csv(self._valves))
        side = LoopThread("modbus", self._make_side())
        side.start()
        self._threads.insert(0, side)
        place = f"{settings.plc_host or settings.address}:{settings.port}"
        role = f"polls the PLC at {place}" if settings.plc_host else f"the PLC polls {place}"
        self._node.get_logger().info(
            f"ready: {role}; {len(self._valves)} valves, {self._station.count} registers, watchdog "
            f"{settings.watchdog:g} s"
        )

    def _work(self) -> None:
        period, due = 1.0 / self._settings.rate, time.monotonic()
        repeat_at = look_at = count_at = due
        while not self.stop.wait(max(0.0, due - time.monotonic())):
            now = time.monotonic()
            self._inbox.deliver()
            if now >= look_at:
                look_at = now + _BETWEEN_SIGNS
                self._signs.deliver()
            if now >= count_at:
                count_at = now + _BETWEEN_COUNTS
                self._look_for_others()
            self._station.beat()
            is_due = now >= repeat_at
            if is_due:
                repeat_at = max(repeat_at + _BETWEEN_COMMANDS, now)
            for valve in range(len(self._valves)):
                self._command(valve, is_due=is_due)
            due = max(due + period, time.monotonic())

    def _finish(self) -> None:
        """Command 0 V to every coil for good, and wait until that is heard."""
        with self._commanding:
            self._is_off = True
            if not self._node.context.ok():
                return
            for voltage in self._voltages:
                voltage.publish(Float64(data=0.0))
        wait_until_heard(self._voltages)

    # --- wiring ---

    def _make_side(self) -> Served:
        settings = self._settings
        if not settings.plc_host:
            return PlcServer(self._station, settings.address, settings.port)
        Extra("pymodbus", "modbus", "a PLC that is polled").require()
        from valve_sim.station.modbus_client import PlcClient

        return PlcClient(
            self._station, settings.plc_host, settings.port, first=settings.first_register, unit=settings.unit,
            period=1.0 / settings.rate, say=self._say,
        )  # fmt: skip

    def _wire(self) -> None:
        interface = self._interface
        for place, valve in enumerate(self._valves):
            self._commands.append(interface.publisher("{valve}/coil_voltage", valve=valve))
            hear_live(interface, self._inbox, self._signs, valve, partial(self._hear, place))

    # --- what is heard and commanded ---

    def _hear(self, valve: int, name: str, value: Any, arrival: Arrival) -> None:
        """Take what a valve says; its current says only that it lives."""
        values = {} if name == "coil_current" else {name: value}
        self._station.hear(valve, time.monotonic(), **values)

    def _command(self, valve: int, *, is_due: bool = False) -> None:
        """Publish a coil's voltage as the PLC wants it, where that has changed or is due to be repeated.

        Nothing is published before the PLC has written to the valve's registers: another node may command it.
        """
        with self._commanding:
            if self._is_off or not self._node.context.ok() or not self._station.is_heard(valve):
                return
            if self._commands[valve] not in self._voltages:
                self._voltages.append(self._commands[valve])
            is_on = self._station.is_on(valve, time.monotonic())
            was_on, self._was_on[valve] = self._was_on[valve], is_on
            if is_on is not was_on or is_due:
                self._commands[valve].publish(Float64(data=self._settings.voltage if is_on else 0.0))
        if was_on and not is_on and self._station.is_silent(valve, time.monotonic()):
            self._say(f"{self._valves[valve]}: de-energised, the PLC has been silent for {self._settings.watchdog:g} s")

    def _look_for_others(self) -> None:
        """Warn of each valve that another node begins to command, too."""
        commanded = [publisher.topic_name for publisher in self._voltages]
        others = {topic for topic in commanded if self._node.count_publishers(topic) > 1}
        for topic in others - self._others:
            self._say(f"{topic}: another node commands this valve, too; let only one of them")
        self._others = others

    def _say(self, words: str) -> None:
        self._node.get_logger().warning(words)
