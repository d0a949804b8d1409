"""What a process may leave behind; light, because the process imports it."""

from __future__ import annotations

import json
import os
import signal
import socket
import time

LEFT = 3


def forks(link: socket.socket, dies: bool) -> None:
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
    link.sendall(json.dumps([os.getpid(), *map(int, told.split())]).encode())
    if dies:
        os._exit(3)
    time.sleep(1000)


def _tell(said: int) -> None:
    os.write(said, b"%d " % os.getpid())
    time.sleep(1000)


def says_no_more(link: socket.socket) -> None:
    """Close the link, and live on."""
    link.close()
    time.sleep(1000)


def take_memory(link: socket.socket, children: int, bytes: int) -> None:
    """So many children take so much each."""
    heard, said = os.pipe()
    for _ in range(children):
        if os.fork() == 0:
            kept = bytearray(bytes)
            kept[::4096] = b"x" * len(kept[::4096])
            _tell(said)
    told = b""
    while told.count(b" ") < children:
        told += os.read(heard, 100)
    link.sendall(b"done")
    time.sleep(1000)
