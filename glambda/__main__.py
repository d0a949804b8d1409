"""`python -m glambda`: the command line."""

from glambda.cli import main

main()
