"""`spotter ros2`: what is known on the bus as standard messages of ROS 2, over rmw_zenoh.

One module for each kind of message holds its mapping, a pure function of our message and the host it is from; ``table``
says which topic becomes which; ``bridge`` subscribes and publishes.
"""
