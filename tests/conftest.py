"""The tests run as the command line does: one thread, asked for before numerical libraries load.

They can be interrupted, and so can what they start, also where a shell began them in the background
and had them ignore SIGINT.
"""

from __future__ import annotations

import signal

from hypothesis import settings

from harness.threads import ask_for_one_thread

ask_for_one_thread()
signal.signal(signal.SIGINT, signal.default_int_handler)
settings.register_profile("same", derandomize=True, deadline=None)
settings.load_profile("same")
