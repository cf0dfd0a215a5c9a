"""The programs: `ros2 run valve_sim valve_node` and the like, or `python -m valve_sim.nodes valve_node`."""

from __future__ import annotations

from valve_sim import early_signals  # noqa: F401 -- first, for its effect
from valve_sim.nodes.starting import Program, chosen

valve_node = Program(
    "valve_node",
    "valve_sim.nodes.valve:valve_node",
    """
    valve_node simulates a valve in real time on ROS 2 topics.

    It obeys voltages on ~/coil_voltage and publishes ~/joint_states, ~/coil, ~/phase and
    ~/is_open. Without parameters it is the shipped valve, named /valve:

        valve_node
        ros2 topic pub --once /valve/coil_voltage std_msgs/msg/Float64 '{data: 9.0}'

    Another valve, sampled at 500 Hz, from a parameter file of a checkout:

        valve_node --ros-args --params-file config/published.yaml \\
            -p publish_rate:=500.0

    A machine of your own, from a plant file:

        valve_node --ros-args -p plant:=mine.yaml
""",
    "docs/tutorials/first_correction.md, docs/how_to/your_own_machine.md, docs/reference/topics.md",
)
identification_node = Program(
    "identification_node",
    "valve_sim.nodes.identification:IdentificationNode",
    """
    identification_node replays a recording beside the model and refits its valve.

    It publishes what was measured and what the model predicts, writes the result to the
    folder `output`, and ends. With mode:=diagnose it also searches for a missing effect,
    and with apply_to:=/valve it sets the result on a running valve if the residual is white:

        identification_node --ros-args -p bag:=bags/live.mcap
""",
    "docs/how_to/diagnosis.md, docs/reference/topics.md",
    codes="0 after the result, Ctrl-C or SIGTERM, 1 after a failure, 2 for unusable input",
)
monitor_node = Program(
    "monitor_node",
    "valve_sim.nodes.monitor:MonitorNode",
    """
    monitor_node watches a valve beside its model, stroke by stroke.

    It learns from the first strokes how the healthy valve moves, raises an alarm on
    /diagnostics when the valve has changed, and publishes on ~/finding what has changed.
    Beside a simulated valve that was started by valve_node:

        monitor_node --ros-args -p measured:=joint_states -p noise_um:=1.0

    Beside a real valve, whose sensors publish /tank_1/valve/measured/joint_states:

        monitor_node --ros-args -p valve_node:=/tank_1/valve \\
            --params-file tank_1.yaml
""",
    "docs/how_to/monitor.md, docs/theory/monitoring.md",
)
command_profile = Program(
    "command_profile",
    "valve_sim.nodes.profile:ProfileNode",
    """
    command_profile commands a valve by a file of times and voltages, and ends.

    It waits until the valve subscribes, sends each voltage at its time, and leaves the coil
    at 0 V however it ends. With a valve_node running:

        echo '[[0.01, 9], [0.04, 0]]' > strokes.yaml
        command_profile --ros-args -p profile:=strokes.yaml
""",
    "docs/how_to/record_next.md",
    codes="0 when all was sent, 1 otherwise, 2 for unusable input",
)

if __name__ == "__main__":
    raise SystemExit(chosen(valve_node, identification_node, monitor_node, command_profile))
