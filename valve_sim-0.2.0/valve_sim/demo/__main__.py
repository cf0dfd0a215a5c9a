"""The command line of the demonstration, and its course."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
import time
from pathlib import Path
from typing import Final

import click
from rich.console import Console

from valve_sim.demo.listener import Listener, message_classes
from valve_sim.demo.performance import Performance
from valve_sim.demo.process import DemoError, ValveProcess
from valve_sim.demo.stopping import StoppedError, StopSignals
from valve_sim.demo.story import Story, comparison
from valve_sim.files.parameter_files import default_valve
from valve_sim.invocation import invocation
from valve_sim.model import ValveError
from valve_sim.traces import BagRecorder, events_from_sensors, read_trace

VOLTS: Final = 9.0
SPEED: Final = 0.02
"""Model seconds a second: a stroke of 10 ms takes half a second, slow enough to watch."""
DISCOVERY: Final = 0.4
"""s in which ROS discovers other nodes."""


def perform(folder: Path, strokes: int, speed: float, console: Console, signals: StopSignals) -> None:
    """Run the demonstration; leaves strokes/ (a rosbag2 bag), stroke.png and valve_node.log in the folder.

    Raises:
        DemoError: no ROS 2, or the node failed.
        StoppedError: a signal came; unfinished files are removed.
        ValveError: the folder cannot be written to.
    """
    bag = folder / "strokes"
    try:
        shutil.rmtree(bag, ignore_errors=True)
        folder.mkdir(parents=True, exist_ok=True)
        log = folder / "valve_node.log"
        log.touch()
    except OSError as error:
        raise DemoError(
            f"{folder}: cannot be written ({error.strerror}); choose another place with --output"
        ) from error
    _enter_ros(folder)
    listener = Listener()
    try:
        time.sleep(DISCOVERY)
        listener.expect_valves(0)
        signals.check()
        console.print(f"starting valve_node at {speed:g} of real time")
        command = [sys.executable, "-m", "valve_sim.nodes", "valve_node", "--ros-args", "-p", f"time_scale:={speed!r}"]
        process = ValveProcess(command, log)
        try:
            with BagRecorder(bag) as recorder:
                performance = Performance(listener, process, recorder, console, speed, signals)
                performance.wait_for_valve()
                with performance.shown():
                    performance.rest()
                    for number in range(1, strokes + 1):
                        console.print(f"\nstroke {number} of {strokes}")
                        performance.stroke(VOLTS)
        finally:
            process.stop()
    finally:
        listener.close()
    _conclude(bag, folder / "stroke.png", performance.story, console)


def _enter_ros(folder: Path) -> None:
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_LOG_DIR", str((folder / "log").resolve()))
    try:
        import rclpy
        from rclpy.signals import SignalHandlerOptions

        message_classes()
    except ImportError as error:
        raise DemoError(
            f"ROS 2 is not here ({error}); source your ROS 2, or type make run, which installs its wheels"
        ) from error
    # Signals are handled by this process: ROS would shut down while a bag is still open.
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)


def _conclude(bag: Path, picture: Path, story: Story, console: Console) -> None:
    from valve_sim.identification.reporting.figures import draw_response, save_figure

    parameters = default_valve().parameters
    seen = events_from_sensors(read_trace(bag), parameters.pilot_gap)
    console.print()
    console.print(comparison(seen))
    console.print(
        "(from the recorded positions, since the voltage on the coil; the lines above are good to one sample, "
        "where none was missed)"
    )
    arrivals = {event.kind: event.after_command for event in seen[0].events} if seen else {}
    names = {"pilot_reaches_main": "t1", "reaches_stop": "t2"}
    figure = draw_response(
        *story.first_stroke(),
        f"valve_node at {VOLTS:g} V, as it published",
        marks={name: arrivals[kind] for kind, name in names.items() if kind in arrivals},
        levels={"gap": parameters.pilot_gap, "stroke": parameters.stroke},
    )
    save_figure(figure, picture)
    console.print(f"recorded {bag}, drew {picture}", highlight=False, soft_wrap=True)
    console.print(f"next: {invocation()} info {shlex.quote(str(bag))}", highlight=False, soft_wrap=True)


@click.command(context_settings={"show_default": True})
@click.option("--strokes", type=click.IntRange(1, 100), default=3, help="How many.")
@click.option("--speed", type=click.FloatRange(0.001, 1.0), default=SPEED, help="Model seconds a second.")
@click.option(
    "--output", type=click.Path(path_type=Path), default=Path("runs/demo"), help="Folder for bag and picture."
)
def main(strokes: int, speed: float, output: Path) -> None:
    """Show a valve at work on ROS 2 topics, record it, and compare it with the paper."""
    try:
        with StopSignals() as signals:
            perform(output, strokes, speed, Console(), signals)
    except ValveError as error:
        click.echo(f"demo: {error}", err=True)
        sys.exit(2)
    except StoppedError:
        click.echo("demo: stopped", err=True)
        sys.exit(130)


if __name__ == "__main__":
    main()
