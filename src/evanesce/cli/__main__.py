"""``python -m evanesce.cli``: the command without its console script."""

from evanesce.cli.app import main

main()
