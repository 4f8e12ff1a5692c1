"""Sets up the work tree: virtual environment, locked packages, interface packages.

Run as ``python -m bootstrap`` in ``ros2_ws`` (that is what ``make setup`` does); needs the standard
library only. Every step has a key, the hash of all that it depends on: a step whose key is
unchanged is skipped, one that did not finish is cleaned up and repeated.
"""
