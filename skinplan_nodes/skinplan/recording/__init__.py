"""Bags of runs: rosbag2 MCAP writer and reader, QoS, schemas, metadata."""
