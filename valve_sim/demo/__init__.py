"""`make run`: a valve at work on ROS 2 topics, for eyes that see it for the first time.

Starts valve_node as a process of its own, in slow motion; commands strokes on its topic; shows what it publishes as it
does so; records the topics as a rosbag2 bag; and puts the event times beside the paper's.

All times are the valve's own, from the stamps of its joint states. A message without a stamp has the stamp of the joint
states that were published with it, so that lines, picture, table and bag say the same, however late messages arrive.
"""
