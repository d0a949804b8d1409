"""What a process may leave behind; light, because the process imports it."""

from __future__ import annotations

import os
import signal
import time
from multiprocessing.connection import Connection

LEFT = 3


def forks(link: Connection, dies: bool) -> None:
    """Fork a child, and a daemon with a child; tell their numbers; die or hang, deaf to signals."""
    signal.pthread_sigmask(signal.SIG_BLOCK, set(signal.Signals))
    heard, said = os.pipe()
    if os.fork() == 0:
        _tell(said)
    if (child := os.fork()) == 0:
        os.setsid()
        if os.fork() == 0:
            os.fork()
            _tell(said)
        os._exit(0)
    os.waitpid(child, 0)
    told = b""
    while told.count(b" ") < LEFT:
        told += os.read(heard, 100)
    print("last words", flush=True)
    link.send([os.getpid(), *map(int, told.split())])
    if dies:
        os._exit(3)
    time.sleep(1000)


def _tell(said: int) -> None:
    os.write(said, b"%d " % os.getpid())
    time.sleep(1000)
