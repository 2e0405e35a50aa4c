"""URDF, the format of ROS: `reading` makes the draft."""
