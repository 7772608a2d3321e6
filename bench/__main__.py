"""``python -m bench`` is ``pulsempc``."""

from bench.cli import main

main()
