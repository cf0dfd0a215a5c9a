"""Publishes a bench's own sensor as the topic that monitor_node and recorders hear: stamped, in metres, + opens.

    python3 docs/examples/sensor_driver.py
    ros2 run valve_sim monitor_node --ros-args -r /valve/coil_voltage:=/lab/supply

/lab/lvdt (std_msgs/Float64) reads 12.5 mm where the valve is closed, and less as it opens. The commands need no
driver: a topic of the same type and unit is remapped.
"""

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

CLOSED_MM = 12.5


class SensorDriver(Node):
    """Of your sensor's own library, take the time at which it sampled; here it is the time of arrival."""

    def __init__(self) -> None:
        super().__init__("sensor_driver")
        self._positions = self.create_publisher(JointState, "/valve/measured/joint_states", qos_profile_sensor_data)
        self.create_subscription(Float64, "/lab/lvdt", self._convert, qos_profile_sensor_data)

    def _convert(self, reading: Float64) -> None:
        message = JointState(name=["pilot_plunger"], position=[1e-3 * (CLOSED_MM - reading.data)])
        message.header.stamp = self.get_clock().now().to_msg()
        self._positions.publish(message)


if __name__ == "__main__":
    rclpy.init()
    try:
        rclpy.spin(SensorDriver())
    except (KeyboardInterrupt, ExternalShutdownException):
        rclpy.try_shutdown()
