"""The tests run as the command line does: one thread, asked for before numerical libraries load."""

from __future__ import annotations

from harness.threads import ask_for_one_thread

ask_for_one_thread()
