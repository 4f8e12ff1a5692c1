"""CPU time per message in the nodes' executor and in rclpy's own, one after the other.

``python benchmarks/executor.py``. A node with as many topics, timers, clients and services as
given takes messages that come one at a time; the thread of the executor is measured alone.
"""

import argparse
import threading
import time
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Int32
from std_srvs.srv import Trigger

from skinplan_nodes.lean_executor import LeanExecutor

ROUNDS = 3
KINDS = (SingleThreadedExecutor, LeanExecutor)


def microseconds(kind: Any, entities: int, messages: int) -> float:
    """Returns the CPU time of the executor's thread per message [us]."""
    context = Context()
    rclpy.init(args=[], context=context)
    node = Node("measured", context=context, use_global_arguments=False)
    came = threading.Event()
    node.create_subscription(Int32, "numbers", lambda _: came.set(), 10)
    for n in range(entities):
        node.create_subscription(Int32, f"other_{n}", lambda _: None, 10)
        node.create_client(Trigger, f"asked_{n}")
    publisher = node.create_publisher(Int32, "numbers", 10)
    executor = kind(context=context)
    executor.add_node(node)
    spent: list[float] = []

    def spin() -> None:
        try:
            executor.spin()
        except ExternalShutdownException:
            spent.append(time.thread_time())

    thread = threading.Thread(target=spin)
    thread.start()
    while publisher.get_subscription_count() == 0:
        time.sleep(0.01)
    for _ in range(messages):
        came.clear()
        publisher.publish(Int32())
        came.wait(5.0)
    rclpy.shutdown(context=context)
    thread.join()
    node.destroy_node()
    return spent[0] / messages * 1e6


def main() -> None:
    """Measures and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--messages", type=int, default=2000)
    given = parser.parse_args()
    print(f"{'topics, clients':>15} {'rclpy [us]':>11} {'lean [us]':>10} {'ratio':>6}")
    for entities in (0, 10, 30):
        rounds = [
            [
                microseconds(kind, entities, given.messages)
                for kind in (SingleThreadedExecutor, LeanExecutor)
            ]
            for _ in range(ROUNDS)
        ]
        theirs, ours = (sorted(row[k] for row in rounds)[ROUNDS // 2] for k in (0, 1))
        print(f"{entities:>15} {theirs:>11.0f} {ours:>10.0f} {theirs / ours:>6.1f}")


if __name__ == "__main__":
    main()
