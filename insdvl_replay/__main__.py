"""Run the command line with ``python -m insdvl_replay``."""

from insdvl_replay.cli import main

main()
