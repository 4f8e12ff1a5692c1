"""Plans and evaluates the 3-D measurement of large skins by a mobile manipulator; no ROS."""

__version__ = "0.1.0"
