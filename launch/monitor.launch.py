"""A monitor of one valve: `ros2 launch valve_sim monitor.launch.py params_file:=tank_1.yaml namespace:=tank_1`.

Beside a valve that valve_node simulates: `measured:=joint_states noise_um:=1.0`.
"""

from launch import LaunchDescription
from valve_sim.nodes.launching import USE_SIM_TIME, one_node

PARAMETERS = {
    **USE_SIM_TIME,
    "valve_node": "name of the valve, below which its topics are, relative to the namespace",
    "measured": "topic of the measured positions below it, or of its coil",
    "noise_um": "µm, standard deviation of the position sensor",
    "state": "file that keeps what commissioning found, for the next start",
}


def generate_launch_description() -> LaunchDescription:
    """The monitor and its arguments."""
    return one_node("monitor", "the valve that is declared, and of the monitor", PARAMETERS)
