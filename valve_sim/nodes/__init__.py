"""ROS 2 shells around the model: valve_node. Only the modules that say so need ROS to be imported."""
