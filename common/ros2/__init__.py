"""ROS 2 without ROS: what rmw_zenoh puts on a Zenoh network, read and written. Needs the extra ``ros2``.

``keys``: key expressions, liveliness tokens, quality of service and attachments. ``types``: messages, CDR and type
hashes. ``reader`` and ``node``: the two directions on a session. A service loads these only when it is asked for a
``ros2:`` source.
"""
