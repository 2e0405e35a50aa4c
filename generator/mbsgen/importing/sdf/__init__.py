"""SDF, the format of Gazebo and Drake: `reading` makes the draft."""
