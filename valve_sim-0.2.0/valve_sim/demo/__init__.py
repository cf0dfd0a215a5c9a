"""`make run`: a valve at work on ROS 2 topics, as a first demonstration.

It starts valve_node as a process of its own, in slow motion; commands strokes on its topic; shows what it publishes;
records the topics as a rosbag2 bag; and compares the event times with the paper's.

All times are the valve's own, from the stamps of its joint states and of its coil, whose voltage dates each command. A
message without a stamp has the stamp of the joint states that were published with it, so that lines, picture, table and
bag agree, however late messages arrive.
"""
