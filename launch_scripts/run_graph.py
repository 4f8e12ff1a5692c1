#!/usr/bin/env python3
"""Starts the node graph without ``ros2 launch``: one process per node, logs per node.

``launch_scripts/run_graph.py --part PART.yaml --serve`` runs the graph with the mock cell until it
is interrupted; ``--help`` lists the options.
"""

import sys

from skinplan_nodes.runner import main

if __name__ == "__main__":
    sys.exit(main())
