"""The ROS nodes of skinplan: each translates, calls one object of the library, replies."""
