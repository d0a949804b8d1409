"""The command line, `glambda`: one module per group of commands.

It names all four packages and imports each only in the command that needs it, so that `--help` is
there at once.  Exit codes: 0 fine; 1 a judged failure; 2 bad input, told in one line: what, where,
remedy.  GLAMBDA_DEBUG=1 shows the traceback instead.
"""

from __future__ import annotations

from glambda.cli.app import app
from glambda.cli.streams import guard_streams, heed_interrupts
from harness.machine.threads import ask_for_one_thread

# isort: off
# in the order of --help
from glambda.cli import listing  # noqa: F401
from glambda.cli import simulation  # noqa: F401
from glambda.cli import watching  # noqa: F401
from glambda.cli import graph  # noqa: F401
from glambda.cli import gallery  # noqa: F401
from glambda.cli import playing  # noqa: F401
from glambda.cli import replays  # noqa: F401
from glambda.cli import stretching  # noqa: F401
from glambda.cli import disturbing  # noqa: F401
from glambda.cli import exchange  # noqa: F401
from glambda.cli import campaigns  # noqa: F401
from glambda.cli import convergence  # noqa: F401
from glambda.cli import painleve  # noqa: F401
from glambda.cli import cases  # noqa: F401
from glambda.cli import claims  # noqa: F401
from glambda.cli import loops  # noqa: F401
from glambda.cli import peers  # noqa: F401
from glambda.cli import studies  # noqa: F401
from glambda.cli import compare  # noqa: F401
from glambda.cli import check  # noqa: F401
from glambda.cli import new  # noqa: F401
from glambda.cli import doctor  # noqa: F401
# isort: on


def main() -> None:
    """Entry point of the command `glambda`."""
    ask_for_one_thread()
    guard_streams()
    heed_interrupts()
    app()
