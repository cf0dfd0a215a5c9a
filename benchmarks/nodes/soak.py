"""A day at work: memory and time of the nodes over 24 h of strokes. `python -m benchmarks.nodes.soak --hours 24`.

One stroke every ten seconds, 8640 in 24 h, at speed on simulated time. Each node is a process of its own:

- valve_node follows a /clock that goes on by half a second whenever the valve has caught up. The stamp of its last
  message is held against the clock: it must be no further behind than one step, at the end as at the start.
- monitor_node watches the independent plant of test/plants at 500 Hz, with the noise and the jitter of the tests.
- identification_node replays bags/live.mcap over and over as fast as it can, until it has replayed as many strokes.

Printed is the resident memory after the first twentieth, and by how much it has grown from there. Wanted: at most 5 MB,
and no drift. Exit code 1 where that falls short. Needs ROS 2; wall time is about five minutes for 24 h.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

from identification.live_strokes import LiveValve
from nodes.plant_on_topics import PlantOnTopics
from nodes.ros_process import Probe

from benchmarks.common import parser, resident, say
from benchmarks.nodes.driver import program, ros, running

PERIOD: Final = 10.0
"""s from stroke to stroke."""
TICK: Final = 0.5
"""s by which the clock of the valve goes on."""
WARM: Final = 0.05
"""Share of the strokes after which memory is looked at first."""
MOST_GROWTH: Final = 5.0
"""MB."""
SECOND: Final = 1_000_000_000
BAG: Final = Path(__file__).resolve().parents[2] / "bags" / "live.mcap"


class Stroked(NamedTuple):
    """How far a node is: its process, strokes so far, and s by which it lags behind the clock."""

    process: int
    strokes: int
    lag: float = 0.0


def soak_valve(strokes: int, folder: Path, probe: Probe) -> Iterator[Stroked]:
    """A clock, commands, and a valve that follows."""
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    clock, voltage = probe.talker("/clock", Clock), probe.talker("coil_voltage", Float64)
    states = probe.hear("joint_states", JointState)
    with running({"node": program("valve_node", "use_sim_time:=true", f"publish_rate:={1.0 / TICK}")}) as started:
        assert probe.until(lambda: clock.get_subscription_count() and voltage.get_subscription_count())
        now = 10 * SECOND

        def go_on() -> int:
            """One tick; ns that the valve then lags behind."""
            nonlocal now
            now += round(TICK * SECOND)
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(now, SECOND)
            clock.publish(message)
            caught_up = probe.until(lambda: bool(states) and now - stamp_of(states[-1]) <= TICK * SECOND, 5.0)
            assert caught_up or not states, f"the valve stays {1e-9 * (now - stamp_of(states[-1])):.1f} s behind"
            del states[:-1]
            return now - stamp_of(states[-1]) if states else 0

        while not states:
            go_on()
        for stroke in range(1, strokes + 1):
            for tick in range(round(PERIOD / TICK)):
                if tick in (0, 2):
                    voltage.publish(Float64(data=0.0 if tick else 9.0))
                lag = go_on()
            yield Stroked(started["node"].pid, stroke, lag / SECOND)


def stamp_of(message: Any) -> int:
    """Ns."""
    return int(message.header.stamp.sec * SECOND + message.header.stamp.nanosec)


def soak_monitor(strokes: int, folder: Path, probe: Probe) -> Iterator[Stroked]:
    """The plant, and a monitor beside it."""
    plant = PlantOnTopics(probe, LiveValve(seed=1, rate=500.0))
    names = ("measured:=measured/joint_states", "use_sim_time:=true", "max_rate:=1e5")
    with running({"node": program("monitor_node", *names)}) as started:
        plant.wait_for_monitor()
        for stroke in range(1, strokes + 1):
            plant.stroke()
            plant.take_reports()
            plant.forget()
            yield Stroked(started["node"].pid, stroke)


def soak_identification(strokes: int, folder: Path, probe: Probe) -> Iterator[Stroked]:
    """A bag over and over."""
    from std_msgs.msg import Float64

    commands, replayed = probe.hear("/identification/coil_voltage", Float64), 0.0
    names = (f"bag:={BAG}", "rate:=0.0", "loop:=true", f"output:={folder}")
    with running({"node": program("identification_node", *names)}) as started:
        while replayed < strokes:
            assert probe.until(lambda: len(commands) >= 20, 60.0), "the replay stands still"
            replayed += len(commands) / 2.0  # on and off
            commands.clear()
            yield Stroked(started["node"].pid, round(replayed))


NODES: Final[dict[str, Callable[[int, Path, Probe], Iterator[Stroked]]]] = {
    "valve": soak_valve,
    "monitor": soak_monitor,
    "identification": soak_identification,
}


def soak(node: str, strokes: int) -> bool:
    """Let a node work, and print what became of it; whether it neither grew nor drifted."""
    warm = end = 0.0
    probe, reached = Probe("/valve"), Stroked(0, 0)
    with tempfile.TemporaryDirectory() as folder:
        for reached in NODES[node](strokes, Path(folder), probe):
            end = resident(reached.process)
            if not warm and reached.strokes >= WARM * strokes:
                warm = end
    probe.close()
    grown, lag = end - warm, reached.lag
    words = f"{reached.strokes} strokes, {warm:.1f} MB after warming up, {grown:+.2f} MB since, {lag:g} s behind"
    return say(grown <= MOST_GROWTH and lag <= TICK, f"{node}_node: {words}")


def main() -> int:
    """Run and print; 1 if anything falls short."""
    known = parser("nodes.soak", __doc__)
    known.add_argument("--hours", type=float, default=24.0, help="of strokes")
    known.add_argument("--only", default=",".join(NODES), help=f"nodes, with commas (default: {','.join(NODES)})")
    given = known.parse_args()
    with ros():
        good = [soak(node, round(3600.0 * given.hours / PERIOD)) for node in given.only.split(",")]
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
