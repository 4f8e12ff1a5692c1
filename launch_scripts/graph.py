"""The description of the node graph for the launch scripts; it lives in ``skinplan_nodes``."""

from skinplan_nodes.graph import GraphSettings, NodeSpec, describe

__all__ = ["GraphSettings", "NodeSpec", "describe"]
