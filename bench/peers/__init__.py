"""Other MPC packages on the same instances, each in an environment of its own.

``python -m bench.peers``, or ``make bench-peers``; see README.md beside this file.
"""
