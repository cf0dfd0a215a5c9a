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
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

from identification.live_strokes import LiveValve
from nodes.plant_on_topics import PlantOnTopics
from nodes.ros_process import Probe, running

from benchmarks.common import parser, resident, say
from benchmarks.nodes.driver import ros

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


class Soaked(NamedTuple):
    """What became of a node: strokes, resident MB after warming up and at the end, s that it lags behind the clock."""

    node: str
    strokes: int
    warm: float
    end: float
    lag: float = 0.0

    @property
    def is_good(self) -> bool:
        """Whether it neither grew nor drifted."""
        return self.end - self.warm <= MOST_GROWTH and self.lag <= TICK

    def line(self) -> str:
        """For people."""
        words = f"{self.strokes} strokes, {self.warm:.1f} MB after warming up, {self.end - self.warm:+.2f} MB since"
        lag = f", {self.lag:g} s behind the clock" if self.node == "valve_node" else ""
        return f"{self.node:<20} {words}{lag}"


def soak_valve(strokes: int, folder: Path) -> Soaked:
    """A clock, commands, and a valve that follows."""
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    probe = Probe("/valve")
    clock, voltage = probe.talker("/clock", Clock), probe.talker("coil_voltage", Float64)
    states = probe.hear("joint_states", JointState)
    arguments = ["--ros-args", "-p", "use_sim_time:=true", "-p", f"publish_rate:={1.0 / TICK}"]
    ticks = round(PERIOD / TICK)
    with running(folder, arguments) as node:
        assert probe.until(lambda: clock.get_subscription_count() and voltage.get_subscription_count())
        now, warm = 10 * SECOND, 0.0

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
        lag = 0
        for stroke in range(strokes):
            for tick in range(ticks):
                if tick in (0, 2):
                    voltage.publish(Float64(data=0.0 if tick else 9.0))
                lag = go_on()
            if stroke == round(WARM * strokes):
                warm = resident(node.process.pid)
        soaked = Soaked("valve_node", strokes, warm, resident(node.process.pid), lag / SECOND)
    probe.close()
    return soaked


def stamp_of(message: Any) -> int:
    """Ns."""
    return int(message.header.stamp.sec * SECOND + message.header.stamp.nanosec)


def soak_monitor(strokes: int, folder: Path) -> Soaked:
    """The plant, and a monitor beside it."""
    probe = Probe("/valve")
    plant = PlantOnTopics(probe, LiveValve(seed=1, rate=500.0))
    names = ("measured:=measured/joint_states", "use_sim_time:=true", "max_rate:=1e5")
    arguments = ["--ros-args", *(word for name in names for word in ("-p", name))]
    warm = 0.0
    with running(folder, arguments, "monitor_node") as node:
        plant.wait_for_monitor()
        for stroke in range(strokes):
            plant.stroke()
            plant.take_reports()
            plant.forget()
            if stroke == round(WARM * strokes):
                warm = resident(node.process.pid)
        soaked = Soaked("monitor_node", strokes, warm, resident(node.process.pid))
    probe.close()
    return soaked


def soak_identification(strokes: int, folder: Path) -> Soaked:
    """A bag over and over."""
    from std_msgs.msg import Float64

    probe = Probe("/identification")
    commands = probe.hear("coil_voltage", Float64)
    names = (f"bag:={BAG}", "rate:=0.0", "loop:=true", f"output:={folder}")
    arguments = ["--ros-args", *(word for name in names for word in ("-p", name))]
    warm, replayed = 0.0, 0.0
    with running(folder, arguments, "identification_node") as node:
        while replayed < strokes:
            assert probe.until(lambda: len(commands) >= 20, 60.0), "the replay stands still"
            replayed += len(commands) / 2.0  # on and off
            commands.clear()
            if not warm and replayed >= WARM * strokes:
                warm = resident(node.process.pid)
        soaked = Soaked("identification_node", round(replayed), warm, resident(node.process.pid))
    probe.close()
    return soaked


NODES: Final[dict[str, Callable[[int, Path], Soaked]]] = {
    "valve": soak_valve,
    "monitor": soak_monitor,
    "identification": soak_identification,
}


def main() -> int:
    """Run and print; 1 if anything falls short."""
    known = parser("nodes.soak", __doc__)
    known.add_argument("--hours", type=float, default=24.0, help="of strokes")
    known.add_argument("--only", default=",".join(NODES), help=f"nodes, with commas (default: {','.join(NODES)})")
    given = known.parse_args()
    good = []
    with ros(), tempfile.TemporaryDirectory() as name:
        for node in given.only.split(","):
            row = NODES[node](round(3600.0 * given.hours / PERIOD), Path(name))
            good.append(say(row.is_good, row.line()))
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
