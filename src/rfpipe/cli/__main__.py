"""``python -m rfpipe.cli``: the command line."""

from rfpipe.cli import main

main()
